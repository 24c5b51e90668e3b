"""The phase field: diffused from the equidistant surface, then, on request, on to a minimal surface (ours).

One parameter, the minimality, moves from the equidistant surface (0) through the diffused one (0.5, the default) to a
minimal surface (1).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dualms.domain import Domain
from dualms.field import minimal
from dualms.field.diffusion import INTERFACE_OVER_GAP, INTERFACE_VOXELS, diffuse
from dualms.field.field import Field, History
from dualms.field.interface import continued, distance_of
from dualms.field.lattice import Lattice, typical_gap
from dualms.progress import Progress
from dualms.skeletons import Skeletons

DIFFUSED = 0.5
"""The minimality at which the diffusion is complete."""
LEAST_VOXELS_A_GAP = 6
"""Below, channels break at the grid: a coarser resolution is raised."""
_COLUMNS = ("iteration", "resolution", "phase", "energy", "kept_voxels")


def solve_phase_field(
    domain: Domain, skeletons: Skeletons, resolution: int, minimality: float, progress: Progress
) -> Field:
    """Separate two skeletons.

    Parameters
    ----------
    domain
        Unit-cube frame.
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
        iteration: ``resolution`` of the grid, ``phase`` (0 diffusion, 1 descent to H = 0), ``energy`` (phase 0: area;
        phase 1: diffuse Willmore energy), ``kept_voxels`` that would have changed the topology.

    Raises
    ------
    EmptySurface
        If one skeleton owns no voxel.
    FieldDiverged
        If a value is not finite.

    Notes
    -----
    Nothing is random. At 128³: about 30 passes over the grid a diffusion step, 60 an iteration of the descent.
    """
    gap = typical_gap(domain, skeletons)
    share = max(0.0, 2 * minimality - 1)
    resolutions = minimal.levels(resolution, gap) if share > 0 else []
    # Finer than its interface the diffusion gains nothing, and splines refine its result as well.
    enough = math.ceil(INTERFACE_VOXELS / (INTERFACE_OVER_GAP * gap))
    least = min(math.ceil(LEAST_VOXELS_A_GAP / gap), minimal.FINEST)
    first = resolutions[0] if resolutions else min(max(resolution, least), enough)
    counts = minimal.iterations(len(resolutions), share)
    log = _Log(progress, [30 * 12 * first**3, *(60 * n * r**3 for n, r in zip(counts, resolutions, strict=True))])
    lattice = Lattice.of(domain, skeletons, first)
    u, _, eps = diffuse(
        lattice, lattice.distances(skeletons), gap, min(1.0, minimality / DIFFUSED), log.phase(0, first)
    )
    samples = continued(distance_of(u, eps), lattice.inside, lattice.grid)
    for level, count in zip(resolutions, counts, strict=True):
        lattice = lattice if level == first else Lattice.of(domain, skeletons, level)
        samples = minimal.minimise(lattice, samples, count, log.phase(1, level))
    progress.report("field", 1.0)
    return Field(samples, "phase-field", History(_COLUMNS, np.array(log.rows)), "cpu")


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
        name = "descent to H = 0, iteration" if phase else "diffusion, step"

        def listen(step: int, steps: int, energy: float, kept: int) -> None:
            self.rows.append([float(len(self.rows)), float(resolution), float(phase), energy, float(kept)])
            note = f"{name} {step} of {steps}, grid {resolution}, energy {energy:.4g}"
            self._progress.report("field", (before + own * step / max(steps, 1)) / total, note)

        return listen
