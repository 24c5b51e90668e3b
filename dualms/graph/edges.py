"""Edges: the dual of the Voronoi cells restricted to the domain (paper, section 4.1).

Two sites are joined where their cells share faces of voxels inside the domain, so nothing joins through a wall or
across a gap, as it does in the Delaunay triangulation of the convex hull.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.domain import Domain, Mask
from dualms.grid import Array, Grid

Cells = NDArray[np.int32]
Edges = NDArray[np.int64]


def connected_cells(inside: Mask, cells: Cells, count: int) -> Cells:
    """Make every cell connected within the domain.

    A cell keeps its largest connected part. The other parts (behind a gap, or orphans of a stretched metric) go to
    the cells around them, front by front.

    Parameters
    ----------
    inside
        (nx, ny, nz) voxels of the domain.
    cells
        (P,) site of each inside voxel, in C order.
    count
        Number of sites.

    Returns
    -------
    (nx, ny, nz) int32, site of each voxel, -1 outside.
    """
    volume = np.full(inside.shape, -1, dtype=np.int32)
    volume[inside] = cells
    _keep_largest_parts(volume, count)
    return volume


def cell_adjacency(volume: Cells) -> tuple[Edges, NDArray[np.int64], Array]:
    """Pairs of cells that share voxel faces.

    Parameters
    ----------
    volume
        (nx, ny, nz) cell of each voxel, -1 outside.

    Returns
    -------
    edges
        (E, 2) sorted pairs.
    faces
        (E,) how many voxel faces each pair shares.
    middles
        (E, 3) of the shared faces the one nearest to their mean, in voxels.
    """
    count = int(volume.max()) + 1
    keys, centers = [], []
    for axis in range(3):
        a = volume[(slice(None),) * axis + (slice(None, -1),)].ravel()
        b = volume[(slice(None),) * axis + (slice(1, None),)].ravel()
        differ = (a != b) & (a >= 0) & (b >= 0)
        low, high = np.minimum(a[differ], b[differ]), np.maximum(a[differ], b[differ])
        keys.append(low.astype(np.int64) * count + high)
        shape = tuple(n - (k == axis) for k, n in enumerate(volume.shape))
        at = np.stack(np.unravel_index(np.flatnonzero(differ), shape), axis=1).astype(float)
        at[:, axis] += 0.5
        centers.append(at)
    key, center = np.concatenate(keys), np.concatenate(centers)
    pairs, owner, faces = np.unique(key, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(owner, center[:, k]) for k in range(3)], axis=1) / faces[:, None]
    away = ((center - mean[owner]) ** 2).sum(axis=1)
    order = np.lexsort((away, owner))
    first = np.searchsorted(owner[order], np.arange(len(pairs)))
    return np.stack([pairs // count, pairs % count], axis=1), faces, center[order[first]]


def inside_segments(
    domain: Domain, grid: Grid, inside: Mask, starts: Array, ends: Array, slack: float = 0.4
) -> NDArray[np.bool_]:
    """(E,) which straight segments stay in the domain, or leave it by less than ``slack`` voxels."""
    lengths = np.linalg.norm(ends - starts, axis=1)
    pieces = np.maximum(np.ceil(lengths / (0.5 * grid.spacing)).astype(int), 1)
    owner = np.repeat(np.arange(len(starts)), pieces + 1)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(pieces + 1) - (pieces + 1), pieces + 1)
    share = (within / pieces[owner])[:, None]
    points = starts[owner] * (1 - share) + ends[owner] * share
    outside = ~inside[tuple(grid.nearest(points).T)]
    outside[outside] = domain.signed_distance(points[outside]) < -slack * grid.spacing
    return np.asarray(np.bincount(owner[outside], minlength=len(starts)) == 0)


def sites_in_cells(grid: Grid, volume: Cells, sites: Array) -> Array:
    """(N, 3) sites, those outside their own cell moved to its nearest voxel (centroids of bent cells lie outside)."""
    own = volume[tuple(grid.nearest(sites).T)] == np.arange(len(sites))
    moved = sites.copy()
    for i in np.flatnonzero(~own):
        voxels = grid.points(volume == i)
        if len(voxels):
            moved[i] = voxels[cKDTree(voxels).query(sites[i])[1]]
    return moved


@numba.njit(cache=True)
def _keep_largest_parts(volume, count):  # type: ignore[no-untyped-def]
    """Free all but the largest connected part of each cell, then let the cells grow into what is free."""
    nx, ny, nz = volume.shape
    flat = volume.ravel()
    size = flat.size
    part = np.full(size, -1, np.int32)
    queue = np.empty(size, np.int32)
    best_size = np.zeros(count, np.int64)
    best_part = np.full(count, -1, np.int32)
    steps = np.array([ny * nz, -ny * nz, nz, -nz, 1, -1])
    parts = 0
    for seed in range(size):
        if flat[seed] < 0 or part[seed] >= 0:
            continue
        label = flat[seed]
        part[seed] = parts
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            v = queue[head]
            head += 1
            z, y, x = v % nz, (v // nz) % ny, v // (ny * nz)
            for k in range(6):
                if _leaves(k, x, y, z, nx, ny, nz):
                    continue
                w = v + steps[k]
                if part[w] < 0 and flat[w] == label:
                    part[w] = parts
                    queue[tail] = w
                    tail += 1
        if tail > best_size[label]:
            best_size[label], best_part[label] = tail, parts
        parts += 1
    tail = 0
    for v in range(size):
        if flat[v] >= 0 and part[v] != best_part[flat[v]]:
            flat[v] = -2
    for v in range(size):
        if flat[v] >= 0:
            queue[tail] = v
            tail += 1
    head = 0
    while head < tail:
        v = queue[head]
        head += 1
        z, y, x = v % nz, (v // nz) % ny, v // (ny * nz)
        for k in range(6):
            if _leaves(k, x, y, z, nx, ny, nz):
                continue
            w = v + steps[k]
            if flat[w] == -2:
                flat[w] = flat[v]
                queue[tail] = w
                tail += 1


@numba.njit(cache=True, inline="always")
def _leaves(k, x, y, z, nx, ny, nz):  # type: ignore[no-untyped-def]
    return (
        (k == 0 and x == nx - 1)
        or (k == 1 and x == 0)
        or (k == 2 and y == ny - 1)
        or (k == 3 and y == 0)
        or (k == 4 and z == nz - 1)
        or (k == 5 and z == 0)
    )
