"""The phase field: diffused from the equidistant surface, then, on request, on to a minimal surface (ours).

One parameter, the minimality, moves from the equidistant surface (0) through the diffused one (0.5, the default) to a
minimal surface (1).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dualms.domain import Domain
from dualms.field import minimal, topology
from dualms.field.diffusion import INTERFACE_OVER_GAP, INTERFACE_VOXELS, diffuse
from dualms.field.field import Field, History
from dualms.field.interface import MARGIN, continued, distance_of
from dualms.field.lattice import Lattice, typical_gap
from dualms.field.samples import GridSamples
from dualms.field.torus import Torus
from dualms.grid import Grid
from dualms.progress import Progress
from dualms.skeletons import Skeletons

DIFFUSED = 0.5
"""The minimality at which the diffusion is complete."""
LEAST_VOXELS_A_GAP = 6
"""Below, channels break at the grid: a coarser resolution is raised."""
_PIN = np.float32(0.02)
"""In voxels: what is left of a detail that is mended."""
_PHASES = ("diffusion, step", "descent to H = 0, iteration", "Newton's method for H = 0, step")
_COLUMNS = ("iteration", "resolution", "phase", "energy", "kept_voxels")


def solve_phase_field(
    domain: Domain | Torus, skeletons: Skeletons, resolution: int, minimality: float, progress: Progress
) -> Field:
    """Separate two skeletons.

    Parameters
    ----------
    domain
        Unit-cube frame, or the unit cube with opposite faces joined.
    skeletons
        Samples ``hot`` and ``cold``.
    resolution
        Voxels along one unit; raised where the skeletons are too dense for it, and not used up where they are sparse.
    minimality
        0: the equidistant surface; 0.5: diffused; 1: a minimal surface.
    progress
        Told about stage ``"field"``.

    Returns
    -------
    Field
        Close to a signed distance near its zero set; on a margin of 0.07 round the domain. Its history has a row an
        iteration: ``resolution`` of the grid, ``phase`` (0 diffusion, 1 descent to H = 0, 2 Newton's method),
        ``energy`` (phase 0: area; 1: diffuse Willmore energy; 2: ∫(2H)² over the surface), ``kept_voxels`` that would
        have changed the topology.

    Raises
    ------
    EmptySurface
        If one skeleton owns no voxel.
    FieldDiverged
        If a value is not finite.

    Notes
    -----
    Nothing is random. Beyond 0.5 each fluid's topology is that of the equidistant surface, on the solver's grid and on
    the one asked for. The authors' U-shape with 370 sites takes 4 s of CPU time for the diffusion, 16 s for the
    descent, 3 s a step of Newton's method, and 15 s to compare with the equidistant surface at 256.
    """
    gap = typical_gap(domain, skeletons)
    share = max(0.0, 2 * minimality - 1)
    # Finer than its interface the diffusion gains nothing, and splines refine its result as well.
    enough = math.ceil(INTERFACE_VOXELS / (INTERFACE_OVER_GAP * gap))
    least = min(math.ceil(LEAST_VOXELS_A_GAP / gap), minimal.FINEST)
    level = minimal.level(resolution, gap, domain.volume) if share > 0 else min(max(resolution, least), enough)
    coarse = min(level, enough)
    lattice = Lattice.of(domain, skeletons, coarse)
    # The descent's stencils end at a wall; on a torus the diffused surface is near enough for Newton's method.
    descent = 0 if lattice.periodic else round(share * minimal.DESCENT_ITERATIONS)
    newton = math.ceil(share * minimal.NEWTON_STEPS)
    log = _Log(progress, [360, 60 * descent, 3000 * newton])
    away = lattice.distances(skeletons)
    u, _, eps = diffuse(lattice, away, gap, min(1.0, minimality / DIFFUSED), log.phase(0, coarse), sealed=share > 0)
    samples = continued(distance_of(u, eps), lattice.inside, lattice.grid, lattice.periodic)
    if coarse < level:
        lattice = Lattice.of(domain, skeletons, level)
    if descent:
        away = lattice.distances(skeletons) if coarse < level else away
        samples = minimal.lower_energy(lattice, samples, away, gap, descent, log.phase(1, level))
    if newton:
        samples = minimal.straightened(domain, lattice, samples, gap, newton, log.phase(2, level))
    if newton and resolution > level and not lattice.periodic:
        samples = _settled(Lattice.of(domain, skeletons, resolution), skeletons, samples)
    progress.report("field", 1.0)
    return Field(samples, "phase-field", History(_COLUMNS, np.array(log.rows)), "cpu")


def _settled(lattice: Lattice, skeletons: Skeletons, samples: GridSamples) -> GridSamples:
    """The field on a finer grid if details show there that the equidistant surface has not, which are mended."""
    grid, inside = lattice.grid, lattice.inside
    hot = lattice.colouring(lattice.nearer_to_hot(skeletons) - np.float32(0.5))
    kept = topology.follow(hot, samples.on(grid), inside, sealed=True)
    if not len(kept):
        return samples
    width = math.ceil(MARGIN / grid.spacing)
    nx, ny, nz = grid.shape
    wide = Grid(grid.origin - width * grid.spacing, grid.spacing, (nx + 2 * width, ny + 2 * width, nz + 2 * width))
    values = samples.on(wide)
    at = tuple((kept + width).T)
    values[at] = np.where(hot[tuple(kept.T)], _PIN, -_PIN) * np.float32(grid.spacing)
    return GridSamples(wide, values)


class _Log:
    """Collects the history and reports progress; ``work`` holds voxel passes a phase, so that progress moves evenly."""

    def __init__(self, progress: Progress, work: list[int]) -> None:
        self.rows: list[list[float]] = []
        self._progress = progress
        self._work = work
        self._begun = -1

    def phase(self, phase: int, resolution: int) -> Callable[[int, int, float, int], None]:
        """The next phase's listener: step, number of steps, energy, number of voxels kept."""
        self._begun += 1
        before, own, total = sum(self._work[: self._begun]), self._work[self._begun], 1.05 * sum(self._work)
        name = _PHASES[phase]

        def listen(step: int, steps: int, energy: float, kept: int) -> None:
            self.rows.append([float(len(self.rows)), float(resolution), float(phase), energy, float(kept)])
            note = f"{name} {step} of {steps}, grid {resolution}, energy {energy:.4g}"
            self._progress.report("field", (before + own * step / max(steps, 1)) / total, note)

        return listen
