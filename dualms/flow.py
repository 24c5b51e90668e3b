"""Guidance: the line along which the fluids should run, at every point of the domain (paper, section 4.1).

The paper assumes a given flow field. Here it is the potential flow between each fluid's ports, or what the user gives.
Only the line counts, not the sense of the flow: fluids in counter-flow add up instead of cancelling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import LinearOperator
from scipy.spatial import cKDTree

from dualms.domain import Domain, Mask
from dualms.grid import Array, Grid
from dualms.progress import Progress, Silent
from dualms.spec import DirectionFlow, FlowSpec, NoFlow, PathFlow

VOXELS = 60_000  # inside voxels of the guidance grid: lines are smooth, so a coarse grid does
RESOLUTIONS = (32, 192)
IDLE_SHARE = 0.05  # below this share of the median speed a fluid's line counts less and less
TOLERANCE = 1e-7  # of the solver's residual
MAX_ITERATIONS = 200
EVEN_STEPS = 6
EVEN_FLOOR = 1e-3  # of the median gradient: keeps the conductivity finite where the flow stands still
SMOOTHING = 1.0  # voxels; rounds the lines at stagnation points and at a path's corners
PATH_SAMPLES = 200_000
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True)
class FlowField:
    """A field of lines: at each voxel a symmetric tensor whose leading eigenvector is the line.

    Parameters
    ----------
    grid, inside
        Voxels, unit-cube frame, and which of them lie in the domain.
    tensor
        (nx, ny, nz, 6) float32, components xx, xy, xz, yy, yz, zz; positive semi-definite with a trace of at most 1.
        Outside it repeats the nearest inside value.
    """

    grid: Grid
    inside: Mask
    tensor: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.inside.shape != self.grid.shape or self.tensor.shape != (*self.grid.shape, 6):
            raise ValueError("a flow field needs an inside flag and six tensor components a voxel")
        if not np.isfinite(self.tensor).all():
            raise ValueError("a flow field's tensor must be finite")

    def tensors(self, points: Array) -> Array:
        """(P, 3, 3) interpolated tensors at ``points`` (P, 3)."""
        full = np.empty((len(points), 3, 3))
        for k, (i, j) in enumerate(PAIRS):
            full[:, i, j] = full[:, j, i] = self.grid.sample(self.tensor[..., k], points)
        return full

    def lines(self, points: Array) -> Array:
        """(P, 3) unit vectors along the lines at ``points`` (P, 3); the sign means nothing."""
        return np.asarray(np.linalg.eigh(self.tensors(points))[1][:, :, 2])

    def strength(self, points: Array) -> Array:
        """(P,) how clear the line is, 0 (none, or two crossing fluids) to 1 (one line)."""
        values = np.linalg.eigvalsh(self.tensors(points))
        return np.asarray(np.clip(values[:, 2] - values[:, 1], 0.0, 1.0))


def flow_field(
    domain: Domain, spec: FlowSpec, units_m: float = 1.0, *, progress: Progress | None = None
) -> FlowField | None:
    """The guidance that a specification asks for.

    Parameters
    ----------
    domain
        Domain with its ports.
    spec
        Kind of guidance; a path's points are in the specification's units.
    units_m
        Metres per unit of the specification.
    progress
        Where to report to.

    Returns
    -------
    FlowField or None
        None for kind ``none``.

    Notes
    -----
    About a second for the potential flow; no randomness.
    """
    progress = progress or Silent()
    if isinstance(spec, NoFlow):
        return None
    voxels = VOXELS if getattr(spec, "spread", 2.0) == 2.0 else VOXELS / 3  # seven solves instead of one
    resolution = int(np.clip((voxels / domain.volume) ** (1 / 3), *RESOLUTIONS))
    grid = domain.grid(resolution)
    inside = domain.inside(grid)
    progress.report("flow", 0.3, f"{int(inside.sum())} voxels")
    if isinstance(spec, DirectionFlow):
        vector = np.array(spec.vector, dtype=float)
        lines = np.broadcast_to(vector / np.linalg.norm(vector), (int(inside.sum()), 3))
        tensors = _outer(lines)
    elif isinstance(spec, PathFlow):
        path = (np.array(spec.points) * units_m - domain.offset_m) / domain.scale_m
        tensors = _outer(path_lines(path, grid.points(inside), grid.spacing / 2))
    else:
        tensors = _potential_tensors(domain, grid, inside, spec.spread, progress)
    return FlowField(grid, inside, _spread(inside, tensors))


def potential(
    inside: Mask, inlet: NDArray[np.int64], outlet: NDArray[np.int64], conductivity: Array | None = None
) -> tuple[Array, Array]:
    """Potential flow from an inlet to an outlet through a voxel domain with tight walls.

    Parameters
    ----------
    inside
        Voxels of the domain; they must be connected.
    inlet, outlet
        (K, 3) indices of the inside voxels at potential 1 and 0 behind half a voxel.
    conductivity
        (P,) positive, for the inside voxels in C order; None for 1 everywhere.

    Returns
    -------
    potential
        (P,) in [0, 1], for the inside voxels in C order.
    velocity
        (P, 3) minus the potential's gradient times the conductivity, per voxel.

    Notes
    -----
    Seven-point Laplacian; conjugate gradients with classical algebraic multigrid, which draws no random numbers.
    """
    number = np.full(inside.shape, -1, dtype=np.int64)
    count = int(inside.sum())
    number[inside] = np.arange(count)
    sources = number[tuple(inlet.T)], number[tuple(outlet.T)]
    resistance = np.ones(count) if conductivity is None else 1.0 / conductivity
    pairs = [_neighbours(number, axis) for axis in range(3)]
    links = [2.0 / (resistance[a] + resistance[b]) for a, b in pairs]
    rows = np.concatenate([np.concatenate([a, b]) for a, b in pairs])
    columns = np.concatenate([np.concatenate([b, a]) for a, b in pairs])
    values = np.concatenate([np.concatenate([link, link]) for link in links])
    diagonal, right = np.bincount(rows, values, count), np.zeros(count)
    for voxels, value in zip(sources, (1.0, 0.0), strict=True):
        np.add.at(diagonal, voxels, 2.0 / resistance[voxels])
        np.add.at(right, voxels, 2.0 * value / resistance[voxels])
    everything = np.arange(count)
    matrix = csr_array(
        coo_array(
            (
                np.concatenate([diagonal, -values]),
                (np.concatenate([everything, rows]), np.concatenate([everything, columns])),
            )
        )
    )
    matrix.indices, matrix.indptr = matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    multigrid = pyamg.ruge_stuben_solver(matrix, max_coarse=200, coarse_solver="splu")
    solution = _conjugate_gradients(matrix, right, multigrid.aspreconditioner())
    velocity = np.zeros((count, 3))
    at_port = np.zeros(count, dtype=bool)
    at_port[np.concatenate(sources)] = True
    for axis, ((a, b), link) in enumerate(zip(pairs, links, strict=True)):
        through = link * (solution[a] - solution[b])
        flux = np.bincount(a, through, count) + np.bincount(b, through, count)
        faces = np.bincount(a, minlength=count) + np.bincount(b, minlength=count)
        # A wall's face carries no flux and counts; beyond a port nothing is known, so its face does not count.
        velocity[:, axis] = flux / np.where(at_port, np.maximum(faces, 1.0), 2.0)
    return solution, velocity


def even_flow(inside: Mask, inlet: NDArray[np.int64], outlet: NDArray[np.int64], exponent: float) -> Array:
    """(P, 3) velocity of the flow that minimises the integral of its speed to the power ``exponent`` (at least 2).

    The higher the exponent, the dearer is a fast spot, so the more evenly the flow fills the domain's sections.

    Notes
    -----
    Its potential solves the p-Laplace equation with p = exponent / (exponent - 1) in (1, 2]; for such p the plain
    iteration on the conductivity, speed^(2 - exponent), decreases the energy at every step (Weiszfeld).
    """
    _, velocity = potential(inside, inlet, outlet)
    if exponent == 2:
        return velocity
    conductivity = np.ones(len(velocity))
    power = exponent / (exponent - 1) - 2
    for _ in range(EVEN_STEPS):
        gradient = np.linalg.norm(velocity, axis=1) / conductivity
        conductivity = (gradient**2 + (EVEN_FLOOR * np.median(gradient)) ** 2) ** (power / 2)
        conductivity /= np.median(conductivity)
        _, velocity = potential(inside, inlet, outlet, conductivity)
    return velocity


def path_lines(path: Array, points: Array, step: float) -> Array:
    """(P, 3) unit tangents of the segment of a polyline ``path`` (K, 3) nearest to ``points`` (P, 3)."""
    parts = np.diff(path, axis=0)
    lengths = np.linalg.norm(parts, axis=1)
    parts, starts, lengths = parts[lengths > 0], path[:-1][lengths > 0], lengths[lengths > 0]
    step = max(step, lengths.sum() / PATH_SAMPLES)
    pieces = np.ceil(lengths / step).astype(int)
    owner = np.repeat(np.arange(len(parts)), pieces)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    samples = starts[owner] + parts[owner] * ((within + 0.5) / pieces[owner])[:, None]
    _, nearest = cKDTree(samples).query(points)
    return np.asarray((parts / lengths[:, None])[owner[nearest]])


def _potential_tensors(domain: Domain, grid: Grid, inside: Mask, spread: float, progress: Progress) -> Array:
    """(P, 6) sum over the fluids of the outer products of their directions."""
    voxels = domain.port_voxels(grid, inside)
    total = np.zeros((int(inside.sum()), 6))
    solved: list[tuple[frozenset[bytes], Array]] = []
    for fluid in (1, -1):
        ends = [
            np.unique(np.concatenate([v for p, v in zip(domain.ports, voxels, strict=True)
                                      if p.fluid == fluid and p.inlet == inlet]), axis=0)
            for inlet in (True, False)
        ]  # fmt: skip
        ends[1] = _without(ends[1], ends[0], inside.shape)
        key = frozenset(e.tobytes() for e in ends)
        velocity = next((v for k, v in solved if k == key), None)
        if velocity is None:
            velocity = even_flow(inside, ends[0], ends[1], spread)
            solved.append((key, velocity))
        speed = np.linalg.norm(velocity, axis=1)
        floor = IDLE_SHARE * float(np.median(speed)) + 1e-30
        lines = velocity / np.maximum(speed, 1e-30)[:, None]
        total += 0.5 * _outer(lines) * (speed / (speed + floor))[:, None]
        progress.report("flow", 0.65 if fluid == 1 else 0.95, "potential flow")
    return total


def _without(voxels: NDArray[np.int64], others: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Voxels that are not among the others; all of them if none would be left."""
    keep = ~np.isin(np.ravel_multi_index(tuple(voxels.T), shape), np.ravel_multi_index(tuple(others.T), shape))
    return voxels[keep] if keep.any() else voxels


def _conjugate_gradients(matrix: csr_array, right: Array, preconditioner: LinearOperator) -> Array:
    """Solution of a symmetric positive definite system.

    SciPy's own takes its inner products from BLAS, whose sums depend on the number of threads, and so would every
    byte of a design; NumPy's sums do not.
    """
    solution = np.zeros(len(right))
    residual = right.copy()
    goal = TOLERANCE**2 * float((right * right).sum())
    search, last = np.zeros(len(right)), 1.0
    for _ in range(MAX_ITERATIONS):
        if float((residual * residual).sum()) <= goal:
            break
        smooth = preconditioner.matvec(residual)
        energy = float((residual * smooth).sum())
        search = smooth + (energy / last) * search
        image = matrix @ search
        step = energy / float((search * image).sum())
        solution += step * search
        residual -= step * image
        last = energy
    return solution


def _neighbours(number: NDArray[np.int64], axis: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers of the voxels on both sides of every inner face across an axis."""
    low = number[(slice(None),) * axis + (slice(None, -1),)]
    high = number[(slice(None),) * axis + (slice(1, None),)]
    both = (low >= 0) & (high >= 0)
    return low[both], high[both]


def _outer(lines: Array) -> Array:
    """(P, 6) outer products of unit vectors with themselves."""
    return np.stack([lines[:, i] * lines[:, j] for i, j in PAIRS], axis=1)


def _spread(inside: Mask, tensors: Array) -> NDArray[np.float32]:
    """Smooth the tensors within the domain and continue them to all voxels."""
    weight = ndimage.gaussian_filter(inside.astype(float), SMOOTHING, mode="constant")
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    spread = np.empty((*inside.shape, 6), dtype=np.float32)
    for k in range(6):
        component = np.zeros(inside.shape)
        component[inside] = tensors[:, k]
        smooth = ndimage.gaussian_filter(component, SMOOTHING, mode="constant") / np.maximum(weight, 1e-12)
        spread[..., k] = smooth[tuple(nearest)]
    return spread
