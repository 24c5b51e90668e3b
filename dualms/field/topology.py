"""Keeping the topology of a two-coloured voxel set: simple points and stray pockets.

A voxel may change colour without changing the topology of either colour exactly if it is *simple*: in its 3×3×3
neighbourhood both colours are locally in one piece. Both are asked for in both adjacencies (6 and 26), which is
stricter than the usual pair and spares checkerboards that marching cubes would resolve arbitrarily. Neighbours outside
the domain are left out, so that a fluid may come to the wall or leave it; where the wall is *sealed*, the outside
counts to what is beside each colour, and a film along the wall may not be pierced either.

References
----------
Bertrand and Malandain 1994, "A new characterization of three-dimensional simple points";
Han, Xu, Prince 2003, "A topology preserving level set method for geometric deformable models".
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from dualms.grid import Grid

Mask = NDArray[np.bool_]


def _neighbours(most: int, among: list[tuple[int, int, int]]) -> NDArray[np.bool_]:
    """(27, 27) whether two cells of a 3×3×3 block touch with at most ``most`` coordinates differing."""
    cells = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    gap = np.abs(cells[:, None] - cells[None])
    touch = (gap.max(-1) == 1) & (gap.sum(-1) <= most)
    keep = np.array([tuple(c) in among for c in cells])
    return np.asarray(touch & keep[:, None] & keep[None])


_ALL = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)]
_N18 = [c for c in _ALL if sum(map(abs, c)) <= 2]
_FACES = [c for c in _ALL if sum(map(abs, c)) == 1]
# Geodesic neighbourhoods: 6-adjacency inside the 18-neighbourhood, 26-adjacency in the whole block.
_TOUCH6 = _neighbours(1, _N18)
_TOUCH26 = _neighbours(3, _ALL)
_CELLS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.int64)
_IS_FACE = np.array([tuple(int(i) for i in c) in _FACES for c in _CELLS])
_IS_ANY = np.array([tuple(int(i) for i in c) in _ALL for c in _CELLS])


@njit(cache=True)  # type: ignore[untyped-decorator]
def _pieces(member: NDArray[np.bool_], start: NDArray[np.bool_], touch: NDArray[np.bool_]) -> int:
    """Components of ``member`` under ``touch`` that hold a cell of ``start``."""
    seen = np.zeros(27, dtype=np.bool_)
    stack = np.empty(27, dtype=np.int64)
    count = 0
    for s in range(27):
        if not (member[s] and start[s]) or seen[s]:
            continue
        count += 1
        stack[0] = s
        seen[s] = True
        top = 1
        while top > 0:
            top -= 1
            c = stack[top]
            for d in range(27):
                if member[d] and not seen[d] and touch[c, d]:
                    seen[d] = True
                    stack[top] = d
                    top += 1
    return count


@njit(cache=True)
def _is_simple(hot, inside, periodic, sealed, i, j, k, cells, touch6, touch26, is_face, is_any):  # type: ignore[no-untyped-def]
    of_hot = np.zeros(27, dtype=np.bool_)
    of_cold = np.zeros(27, dtype=np.bool_)
    beside_hot = np.zeros(27, dtype=np.bool_)
    beside_cold = np.zeros(27, dtype=np.bool_)
    for c in range(27):
        a, b, d = i + cells[c, 0], j + cells[c, 1], k + cells[c, 2]
        if not is_any[c]:
            continue
        if periodic:
            a, b, d = a % hot.shape[0], b % hot.shape[1], d % hot.shape[2]
        out = a < 0 or b < 0 or d < 0 or a >= hot.shape[0] or b >= hot.shape[1] or d >= hot.shape[2]
        out = out or not inside[a, b, d]
        of_hot[c] = not out and hot[a, b, d]
        of_cold[c] = not out and not hot[a, b, d]
        beside_hot[c] = of_cold[c] or out
        beside_cold[c] = of_hot[c] or out
    alone = (
        _pieces(of_hot, is_face, touch6) == 1
        and _pieces(of_cold, is_any, touch26) == 1
        and _pieces(of_cold, is_face, touch6) == 1
        and _pieces(of_hot, is_any, touch26) == 1
    )
    return alone and (
        not sealed
        or (
            _pieces(beside_hot, is_face, touch6) == 1
            and _pieces(beside_hot, is_any, touch26) == 1
            and _pieces(beside_cold, is_face, touch6) == 1
            and _pieces(beside_cold, is_any, touch26) == 1
        )
    )


@njit(cache=True)
def _flip_simple(hot, inside, periodic, sealed, order, cells, touch6, touch26, is_face, is_any):  # type: ignore[no-untyped-def]
    """Change the colour of the listed voxels where that is simple, in rounds until none is left to change."""
    pending = np.ones(len(order), dtype=np.bool_)
    changed = True
    while changed:
        changed = False
        for n in range(len(order)):
            if not pending[n]:
                continue
            i, j, k = order[n, 0], order[n, 1], order[n, 2]
            if _is_simple(hot, inside, periodic, sealed, i, j, k, cells, touch6, touch26, is_face, is_any):
                hot[i, j, k] = not hot[i, j, k]
                pending[n] = False
                changed = True
    return pending


def follow(
    hot: Mask, values: NDArray[np.float32], inside: Mask, periodic: bool = False, sealed: bool = False
) -> NDArray[np.int64]:
    """Bring a colouring towards the sign of ``values`` without changing its topology.

    Parameters
    ----------
    hot
        (nx, ny, nz) current colouring; changed in place.
    values
        (nx, ny, nz) field whose sign is wanted.
    inside
        (nx, ny, nz) the domain.
    periodic
        Whether the box continues across its faces.
    sealed
        Whether each colour's own topology is kept, also where the other one could come between it and the wall.

    Returns
    -------
    (K, 3) int64
        Voxels that had to keep their colour.
    """
    wanted = values > 0
    order = np.argwhere((wanted != hot) & inside)
    if len(order) == 0:
        return order
    # The surest first: it has moved farthest past the interface.
    order = order[np.argsort(-np.abs(values[tuple(order.T)]), kind="stable")]
    kept = _flip_simple(hot, inside, periodic, sealed, order, _CELLS, _TOUCH6, _TOUCH26, _IS_FACE, _IS_ANY)
    return np.asarray(order[kept], dtype=np.int64)


def without_pockets(hot: Mask, inside: Mask, skeleton: tuple[Mask, Mask]) -> tuple[Mask, int]:
    """Give each stray piece of a colour to the other colour.

    A piece is stray if it holds no voxel of its own skeleton. Pieces that do hold one but are not the largest such
    piece stay, for the caller to judge.

    Returns
    -------
    hot
        (nx, ny, nz) the new colouring.
    int
        Number of voxels that changed.
    """
    new = hot.copy()
    for _ in range(4):
        before = new.copy()
        for colour, own in ((True, skeleton[0]), (False, skeleton[1])):
            pieces, count = ndimage.label((new == colour) & inside)
            keep = np.zeros(count + 1, dtype=bool)
            keep[np.unique(pieces[own & inside])] = True
            keep[0] = True
            new[~keep[pieces]] = not colour
        if np.array_equal(new, before):
            break
    return new, int(((new != hot) & inside).sum())


def voxels_of(samples: NDArray[np.float64], grid: Grid, inside: Mask) -> Mask:
    """Inside voxels that hold samples (P, 3); a sample on the wall counts for the nearest inside voxel."""
    away, nearest = ndimage.distance_transform_edt(~inside, return_indices=True)
    at = tuple(grid.nearest(samples).T)
    close = away[at] < 2
    marked = np.zeros(grid.shape, dtype=bool)
    marked[tuple(index[at][close] for index in nearest)] = True
    return marked


def component_counts(hot: Mask, inside: Mask) -> tuple[int, int]:
    """Number of 6-connected pieces of each colour."""
    return int(ndimage.label(hot & inside)[1]), int(ndimage.label(~hot & inside)[1])


def euler_characteristic(hot: Mask) -> int:
    """Euler characteristic of the union of the closed voxels of a set: vertices - edges + faces - cells."""
    padded = np.pad(hot, 1)
    chi = 0
    for axes in range(8):
        cell = padded
        dimension = 3
        for axis in range(3):
            if axes >> axis & 1:
                # A vertex, edge or face belongs to the union if a voxel next to it does.
                low = [slice(None)] * 3
                high = [slice(None)] * 3
                low[axis], high[axis] = slice(None, -1), slice(1, None)
                cell = cell[tuple(low)] | cell[tuple(high)]
                dimension -= 1
        chi += (-1) ** dimension * int(cell.sum())
    return chi
