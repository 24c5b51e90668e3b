"""Samples of a domain's boundary, of which ports take what they cover."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dualms.mesh import DomainMesh

Array = NDArray[np.float64]

MOST_SAMPLES = 4_000_000  # of the boundary; beyond, long thin triangles are cut into rows
THIN = 4  # times the samples that its area asks for
SAMPLES_ACROSS = 400  # sample spacing over the domain's longest side; finer than the finest default grid


def boundary_samples(
    mesh: DomainMesh, wanted: NDArray[np.bool_] | None = None
) -> tuple[Array, NDArray[np.int64], Array]:
    """(S, 3) points on a subdivision of each triangle, (S,) their triangles, and (S,) the area that each stands for.

    Where evenly cut triangles would have too many, the long thin ones are cut into rows across: CAD writes a cylinder
    as hundreds of slivers, which otherwise have as many samples each as a fat triangle of their length.

    Parameters
    ----------
    mesh
        Any mesh; how a triangle is cut depends on all of it.
    wanted
        (F,) the triangles to sample; default all.
    """
    step = float(np.ptp(mesh.vertices_m, axis=0).max()) / SAMPLES_ACROSS
    corners = mesh.vertices_m[mesh.faces]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    along, across = (
        np.clip(np.ceil(lengths / step).astype(np.int64), 1, 2 * SAMPLES_ACROSS)
        for lengths in (edges.max(axis=1), edges.min(axis=1))
    )
    thin = along**2 > THIN * np.maximum(2 * mesh.areas / step**2, along)
    if (along**2).sum() <= MOST_SAMPLES:
        thin[:] = False
    across[~thin] = 0
    # The corner opposite to the shortest edge comes first.
    tip = np.where(thin, edges.argmin(axis=1) + 2, 0)
    corners = np.take_along_axis(corners, ((tip[:, None] + np.arange(3)) % 3)[:, :, None], axis=1)
    if wanted is None:
        wanted = np.ones(len(mesh.faces), dtype=bool)
    points, owners, areas = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for n, m in np.unique(np.stack([along, across], axis=1)[wanted], axis=0).tolist():
        weights, parts = _rows(n, m) if m else _congruent(n)
        which = np.flatnonzero(wanted & (along == n) & (across == m))
        points.append(np.einsum("wk,fkd->fwd", weights, corners[which]).reshape(-1, 3))
        owners.append(np.repeat(which, len(weights)))
        areas.append((mesh.areas[which, None] / parts).ravel())
    return np.concatenate(points), np.concatenate(owners).astype(np.int64), np.concatenate(areas)


def _congruent(n: int) -> tuple[Array, Array]:
    """(n², 3) barycentric centroids of a triangle's n² congruent parts, and (n²,) its area over theirs."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    up = np.stack([i, j], -1)[i + j < n] + 1 / 3
    down = np.stack([i, j], -1)[i + j < n - 1] + 2 / 3
    uv = np.concatenate([up, down]) / n
    return np.column_stack([1 - uv.sum(axis=1), uv]), np.full(n * n, float(n * n))


def _rows(n: int, m: int) -> tuple[Array, Array]:
    """The same for n rows from the first corner on, the last of m parts, the others of as many as their width asks."""
    row = np.arange(n)
    count = np.ceil((row + 0.5) / n * m).astype(np.int64)
    row = np.repeat(row, count)
    share = (row + 0.5) / n
    place = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[row]
    weights = np.column_stack([1 - share, share * (1 - place), share * place])
    return weights, n * n * count[row] / (2 * row + 1)
