"""Sites: a centroidal Voronoi tessellation of the domain's voxels (paper, section 4.1; Liu et al. 2009).

With a stretch the tessellation is centroidal in a metric that is shorter along the flow (Du and Wang 2005), so that
cells come out longer along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.grid import Array
from dualms.progress import Progress, Silent

MAX_ITERATIONS = 200
TOLERANCE = 2e-4  # relative decrease of the energy in one iteration below which Lloyd's iteration ends
NEIGHBOURS = 96  # sites kept in a site's list; a voxel whose bound lies beyond the list looks at all sites


@dataclass(frozen=True)
class Tessellation:
    """Sites and the cells that they own.

    Parameters
    ----------
    sites
        (N, 3) float64.
    cells
        (P,) int32, for each voxel the index of its site.
    energy
        (K,) float64, mean over the voxels of the squared distance to their site, one an iteration, not increasing.
    """

    sites: Array
    cells: NDArray[np.int32]
    energy: Array


def lloyd(
    points: Array,
    count: int,
    seed: int,
    *,
    metric: Array | None = None,
    spread: float = 1.0,
    density: Array | None = None,
    progress: Progress | None = None,
) -> Tessellation:
    """Move random sites to the centroids of their cells until the energy settles.

    Parameters
    ----------
    points
        (P, 3) voxel centres of the domain.
    count
        Number of sites, at most P.
    seed
        Seed of the first sites.
    metric
        (P, 6) symmetric positive definite metric (xx, xy, xz, yy, yz, zz) at each voxel; None for Euclid's.
    spread
        Smallest eigenvalue of the metric, over all voxels.
    density
        (P,) positive weight of each voxel; cells shrink where it is high (as density^(-1/5) in edge length).
    progress
        Where to report to.

    Notes
    -----
    Every iteration assigns each voxel to its nearest site exactly: candidates come from the neighbours of its last
    site in order of distance and end where the triangle inequality rules the rest out. About 30 distances a voxel.
    """
    progress = progress or Silent()
    generator = np.random.default_rng(seed)
    mass = np.ones(len(points)) if density is None else np.asarray(density, dtype=float)
    chance = mass**0.6 / (mass**0.6).sum()  # the point density that the optimum tends to in three dimensions
    sites = points[np.sort(generator.choice(len(points), size=count, replace=False, p=chance))]
    tensor = np.zeros((0, 6)) if metric is None else metric
    cells = cKDTree(sites).query(points)[1].astype(np.int32)
    energies: list[float] = []
    for iteration in range(MAX_ITERATIONS):
        lists = _neighbour_lists(sites)
        energy = float((mass * _assign(points, tensor, spread, sites, *lists, cells)).sum() / mass.sum())
        energies.append(energy)
        progress.report("graph", 0.1 + 0.6 * iteration / MAX_ITERATIONS, f"Lloyd {iteration}, energy {energy:.3e}")
        if iteration and energies[-2] - energy < TOLERANCE * energy:
            break
        sites = _centroids(points, mass, tensor, cells, sites)
    return Tessellation(sites, cells, np.array(energies))


def stretched_metric(lines: Array, strength: Array, stretch: float) -> tuple[Array, float]:
    """Metric of determinant 1 in which cells are ``stretch`` times longer along a line where it is clear.

    Parameters
    ----------
    lines
        (P, 3) unit vectors.
    strength
        (P,) 0 to 1; the stretch fades to 1 where the line is unclear.
    stretch
        Length over width, at least 1.

    Returns
    -------
    metric
        (P, 6).
    spread
        Its smallest eigenvalue anywhere.
    """
    local = 1.0 + (stretch - 1.0) * strength
    along, across = local ** (-4 / 3), local ** (2 / 3)
    excess = along - across
    x, y, z = lines.T
    metric = np.stack([across + excess * x * x, excess * x * y, excess * x * z,
                       across + excess * y * y, excess * y * z, across + excess * z * z], axis=1)  # fmt: skip
    return metric, float(along.min())


def _neighbour_lists(sites: Array) -> tuple[NDArray[np.int32], Array]:
    """For each site the other sites by distance, and the distances; (N, K) both."""
    reach = min(NEIGHBOURS, len(sites))
    distance, index = cKDTree(sites).query(sites, k=reach)
    return np.atleast_2d(index).reshape(len(sites), reach).astype(np.int32), distance.reshape(len(sites), reach)


@numba.njit(cache=True, inline="always")
def _squared(metric, i, x, y, z):  # type: ignore[no-untyped-def]
    if metric.shape[0] == 0:
        return x * x + y * y + z * z
    return (
        metric[i, 0] * x * x
        + metric[i, 3] * y * y
        + metric[i, 5] * z * z
        + 2.0 * (metric[i, 1] * x * y + metric[i, 2] * x * z + metric[i, 4] * y * z)
    )


@numba.njit(cache=True, parallel=True)
def _assign(points, metric, spread, sites, near, gap, cells):  # type: ignore[no-untyped-def]
    """Give each voxel to its nearest site, in place; return the squared distances."""
    squared = np.empty(points.shape[0])
    reach = near.shape[1]
    complete = reach == sites.shape[0]
    for i in numba.prange(points.shape[0]):
        old = cells[i]
        x, y, z = points[i, 0] - sites[old, 0], points[i, 1] - sites[old, 1], points[i, 2] - sites[old, 2]
        best, chosen = _squared(metric, i, x, y, z), old
        euclid = np.sqrt(x * x + y * y + z * z)
        ended = complete
        for k in range(reach):
            if gap[old, k] > euclid + np.sqrt(best / spread):
                ended = True
                break
            j = near[old, k]
            d = _squared(metric, i, points[i, 0] - sites[j, 0], points[i, 1] - sites[j, 1], points[i, 2] - sites[j, 2])
            if d < best:
                best, chosen = d, j
        if not ended:
            for j in range(sites.shape[0]):
                d = _squared(
                    metric, i, points[i, 0] - sites[j, 0], points[i, 1] - sites[j, 1], points[i, 2] - sites[j, 2]
                )
                if d < best:
                    best, chosen = d, j
        cells[i] = chosen
        squared[i] = best
    return squared


@numba.njit(cache=True)
def _centroids(points, mass, metric, cells, sites):  # type: ignore[no-untyped-def]
    """Minimiser of each cell's energy; a site without voxels stays."""
    count = sites.shape[0]
    matrix = np.zeros((count, 3, 3))
    right = np.zeros((count, 3))
    euclid = metric.shape[0] == 0
    for i in range(points.shape[0]):
        c, m = cells[i], mass[i]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if euclid:
            matrix[c, 0, 0] += m
            right[c, 0] += m * x
            right[c, 1] += m * y
            right[c, 2] += m * z
        else:
            xx, xy, xz = m * metric[i, 0], m * metric[i, 1], m * metric[i, 2]
            yy, yz, zz = m * metric[i, 3], m * metric[i, 4], m * metric[i, 5]
            matrix[c, 0, 0] += xx
            matrix[c, 0, 1] += xy
            matrix[c, 0, 2] += xz
            matrix[c, 1, 1] += yy
            matrix[c, 1, 2] += yz
            matrix[c, 2, 2] += zz
            right[c, 0] += xx * x + xy * y + xz * z
            right[c, 1] += xy * x + yy * y + yz * z
            right[c, 2] += xz * x + yz * y + zz * z
    moved = sites.copy()
    for c in range(count):
        if matrix[c, 0, 0] == 0.0:
            continue
        if euclid:
            moved[c] = right[c] / matrix[c, 0, 0]
        else:
            matrix[c, 1, 0], matrix[c, 2, 0], matrix[c, 2, 1] = matrix[c, 0, 1], matrix[c, 0, 2], matrix[c, 1, 2]
            moved[c] = np.linalg.solve(matrix[c], right[c])
    return moved
