"""Which triangles of a mesh meet others than along the edges and corners that they share: exact, on a lattice.

Coordinates are integers below 2²⁸, so that the signs of all determinants are exact in 64-bit integers, with one carry.
Candidates come from a bounding-volume tree over the triangles in Morton order (Karras 2012, "Maximizing parallelism in
the construction of BVHs", here as a complete binary tree).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from dualms.triangles import TriangleMesh

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
Boxes = NDArray[np.int32]

LATTICE_BITS = 28
_LEAF = 4  # triangles a leaf
_LOW_BITS = 30
_LOW = (1 << _LOW_BITS) - 1


def crossing_triangles(mesh: TriangleMesh, step: float, asked: Mask | None = None) -> Mask:
    """Triangles that touch or cross others beyond shared edges and corners, or have no area.

    Parameters
    ----------
    mesh
        Any triangles; vertices are taken as equal by index.
    step
        Edge of the lattice that the vertices lie on (or are rounded to); its extent is at most 2²⁸ steps.
    asked
        (F,) bool: only pairs with one of these are looked at, and only they are asked for their area; default all.

    Returns
    -------
    (F,) bool
        Exact for vertices on the lattice.

    Notes
    -----
    About a second for a million triangles on two cores; a tenth of it where few are asked, whose tree is small.
    """
    chosen = np.arange(len(mesh.faces)) if asked is None else np.flatnonzero(asked)
    bad = np.zeros(len(mesh.faces), dtype=np.bool_)
    if len(chosen) == 0:
        return bad
    points = np.rint(mesh.vertices / step).astype(np.int64)
    points -= points.min(axis=0)
    if points.max() >= 1 << LATTICE_BITS:
        raise ValueError(f"the mesh is wider than 2^{LATTICE_BITS} steps of {step:.3g}")
    boxes = _boxes(points, mesh.faces, chosen)
    order = np.argsort(_morton(boxes), kind="stable")
    chosen, boxes = chosen[order], boxes[order]
    place = np.full(len(mesh.faces), -1)
    place[chosen] = np.arange(len(chosen))
    # In the tree's order where all are in it: neighbours then walk through the same nodes.
    walkers = chosen if asked is None else np.arange(len(mesh.faces))
    _search(points, mesh.faces, walkers, chosen, place, boxes, _tree(boxes), bad)
    return bad


@njit(cache=True)
def _boxes(points: Ints, faces: Ints, chosen: Ints) -> Boxes:
    """(C, 6) bounding boxes of chosen faces."""
    boxes = np.empty((len(chosen), 6), dtype=np.int32)
    for n in range(len(chosen)):
        i, j, k = faces[chosen[n]]
        for axis in range(3):
            x, y, z = points[i, axis], points[j, axis], points[k, axis]
            boxes[n, axis], boxes[n, axis + 3] = min(x, y, z), max(x, y, z)
    return boxes


@njit(cache=True)
def _morton(boxes: Boxes) -> Ints:
    """(C,) bits of the three coordinates of the boxes' middles interleaved, 20 of each."""
    code = np.zeros(len(boxes), dtype=np.int64)
    for n in range(len(boxes)):
        for axis in range(3):
            middle = (np.int64(boxes[n, axis]) + boxes[n, axis + 3]) // 2 >> (LATTICE_BITS - 20)
            for bit in range(20):
                code[n] |= ((middle >> bit) & 1) << (3 * bit + axis)
    return code


def _tree(triangles: Boxes) -> Boxes:
    """(2L, 6) boxes of a complete binary tree, root at 1, over L leaves (a power of two)."""
    starts = np.arange(0, len(triangles), _LEAF)
    leaves = 1 << int(np.ceil(np.log2(max(len(starts), 1))))
    boxes = np.empty((2 * leaves, 6), dtype=np.int32)
    boxes[:, :3], boxes[:, 3:] = 1 << LATTICE_BITS, -1  # an empty box meets nothing
    boxes[leaves : leaves + len(starts), :3] = np.minimum.reduceat(triangles[:, :3], starts)
    boxes[leaves : leaves + len(starts), 3:] = np.maximum.reduceat(triangles[:, 3:], starts)
    while leaves > 1:
        below = boxes[leaves : 2 * leaves]
        leaves //= 2
        boxes[leaves : 2 * leaves, :3] = np.minimum(below[::2, :3], below[1::2, :3])
        boxes[leaves : 2 * leaves, 3:] = np.maximum(below[::2, 3:], below[1::2, 3:])
    return boxes


@njit(parallel=True, cache=True)
def _search(
    p: Ints,
    faces: Ints,
    walkers: Ints,
    members: Ints,
    place: Ints,
    members_boxes: Boxes,
    tree: Boxes,
    bad: Mask,
) -> None:
    """Mark in ``bad`` the crossing pairs of a walker and a member of the tree; a pair of members is met once.

    Walkers go through the tree in groups as large as its leaves.
    """
    leaves = len(tree) // 2
    for group in prange((len(walkers) + _LEAF - 1) // _LEAF):
        begin, end = group * _LEAF, min(group * _LEAF + _LEAF, len(walkers))
        boxes = _boxes(p, faces, walkers[begin:end])
        whole = np.empty(6, dtype=np.int64)
        earliest = len(members)
        for axis in range(3):
            whole[axis], whole[axis + 3] = boxes[:, axis].min(), boxes[:, axis + 3].max()
        for n in range(begin, end):
            s = walkers[n]
            earliest = min(earliest, place[s])
            if place[s] >= 0:
                n0, n1, n2 = _normal(p[faces[s, 0]], p[faces[s, 1]], p[faces[s, 2]])
                if n0 == 0 and n1 == 0 and n2 == 0:
                    bad[s] = True
        stack = np.empty(64, dtype=np.int64)
        stack[0] = 1
        size = 1
        while size:
            size -= 1
            node = stack[size]
            if _apart(whole, tree[node]):
                continue
            if node < leaves:
                stack[size], stack[size + 1] = 2 * node, 2 * node + 1
                size += 2
                continue
            first = (node - leaves) * _LEAF
            last = min(first + _LEAF, len(members))
            if last <= earliest:
                continue  # met from there
            for n in range(begin, end):
                s = walkers[n]
                for m in range(max(first, place[s] + 1), last):
                    t = members[m]
                    if t != s and not _apart(boxes[n - begin], members_boxes[m]) and _cross(p, faces[s], faces[t]):
                        bad[s] = bad[t] = True


@njit(cache=True)
def _apart(one: Boxes, two: Boxes) -> bool:
    return bool(
        one[0] > two[3] or one[1] > two[4] or one[2] > two[5] or two[0] > one[3] or two[1] > one[4] or two[2] > one[5]
    )


@njit(cache=True)
def _cross(p: Ints, s: Ints, t: Ints) -> bool:
    """Whether two triangles meet beyond what they share by index."""
    # Both cyclically turned so that shared corners come first.
    shared = 0
    first = second = -1
    for i in range(3):
        for j in range(3):
            if s[i] == t[j]:
                shared += 1
                if shared == 1:
                    first, second = i, j
    if shared == 3:
        return True
    if shared == 0:
        a, b, c = p[s[0]], p[s[1]], p[s[2]]
        d, e, f = p[t[0]], p[t[1]], p[t[2]]
        x, y, z = _side(a, b, c, d), _side(a, b, c, e), _side(a, b, c, f)
        if (x > 0 and y > 0 and z > 0) or (x < 0 and y < 0 and z < 0):
            return False
        return (
            _pierces(d, e, a, b, c) or _pierces(e, f, a, b, c) or _pierces(f, d, a, b, c)
            or _pierces(a, b, d, e, f) or _pierces(b, c, d, e, f) or _pierces(c, a, d, e, f)
        )  # fmt: skip
    if shared == 1:
        a, b, c = p[s[first]], p[s[(first + 1) % 3]], p[s[(first + 2) % 3]]
        d, e = p[t[(second + 1) % 3]], p[t[(second + 2) % 3]]
        if (_side(a, b, c, d) * _side(a, b, c, e) > 0) or (_side(a, d, e, b) * _side(a, d, e, c) > 0):
            return False
        # They go on beyond the common corner if the far edge of one reaches the other.
        return _pierces(b, c, a, d, e) or _pierces(d, e, a, b, c)
    u, w = -1, -1
    for i in range(3):
        if s[i] != t[0] and s[i] != t[1] and s[i] != t[2]:
            u = i
        if t[i] != s[0] and t[i] != s[1] and t[i] != s[2]:
            w = i
    a, b, c, d = p[s[(u + 1) % 3]], p[s[(u + 2) % 3]], p[s[u]], p[t[w]]
    if _side(a, b, c, d) != 0:
        return False
    axis = _widest(a, b, c)
    return _turn(a, b, c, axis) * _turn(a, b, d, axis) > 0  # folded over the common edge


@njit(cache=True)
def _normal(a: Ints, b: Ints, c: Ints) -> tuple[int, int, int]:
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0


@njit(cache=True)
def _side(a: Ints, b: Ints, c: Ints, d: Ints) -> int:
    """Sign of det(b - a, c - a, d - a): the minors fit 60 bits, the sum is carried in two words."""
    n0, n1, n2 = _normal(a, b, c)
    w0, w1, w2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    high = (n0 >> _LOW_BITS) * w0 + (n1 >> _LOW_BITS) * w1 + (n2 >> _LOW_BITS) * w2
    low = (n0 & _LOW) * w0 + (n1 & _LOW) * w1 + (n2 & _LOW) * w2
    high += low >> _LOW_BITS
    low &= _LOW
    if high == 0:
        return 1 if low > 0 else 0
    return 1 if high > 0 else -1


@njit(cache=True)
def _pierces(p: Ints, q: Ints, a: Ints, b: Ints, c: Ints) -> bool:
    """Whether the closed segment p-q meets the closed triangle a-b-c."""
    above, below = _side(a, b, c, p), _side(a, b, c, q)
    if above * below > 0:
        return False
    if above == 0 and below == 0:
        return _overlaps(p, q, a, b, c)
    x, y, z = _side(p, q, a, b), _side(p, q, b, c), _side(p, q, c, a)
    return (x >= 0 and y >= 0 and z >= 0) or (x <= 0 and y <= 0 and z <= 0)


@njit(cache=True)
def _widest(a: Ints, b: Ints, c: Ints) -> int:
    """The axis along which a triangle's projection is largest."""
    n0, n1, n2 = _normal(a, b, c)
    if abs(n0) >= abs(n1) and abs(n0) >= abs(n2):
        return 0
    return 1 if abs(n1) >= abs(n2) else 2


@njit(cache=True)
def _turn(a: Ints, b: Ints, c: Ints, axis: int) -> int:
    """Sign of the turn a-b-c in the projection along an axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    value = (b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i])
    return 1 if value > 0 else (-1 if value < 0 else 0)


@njit(cache=True)
def _overlaps(p: Ints, q: Ints, a: Ints, b: Ints, c: Ints) -> bool:
    """Whether a segment meets a triangle of its own plane."""
    axis = _widest(a, b, c)
    if _within(p, a, b, c, axis):
        return True
    return _meet(p, q, a, b, axis) or _meet(p, q, b, c, axis) or _meet(p, q, c, a, axis)


@njit(cache=True)
def _within(p: Ints, a: Ints, b: Ints, c: Ints, axis: int) -> bool:
    x, y, z = _turn(a, b, p, axis), _turn(b, c, p, axis), _turn(c, a, p, axis)
    return (x >= 0 and y >= 0 and z >= 0) or (x <= 0 and y <= 0 and z <= 0)


@njit(cache=True)
def _meet(p: Ints, q: Ints, a: Ints, b: Ints, axis: int) -> bool:
    """Whether two closed segments of a plane meet."""
    w, x, y, z = _turn(a, b, p, axis), _turn(a, b, q, axis), _turn(p, q, a, axis), _turn(p, q, b, axis)
    if w * x < 0 and y * z < 0:
        return True
    return (
        (w == 0 and _between(p, a, b)) or (x == 0 and _between(q, a, b))
        or (y == 0 and _between(a, p, q)) or (z == 0 and _between(b, p, q))
    )  # fmt: skip


@njit(cache=True)
def _between(p: Ints, a: Ints, b: Ints) -> bool:
    """Whether a point of a line lies between two of its points."""
    for k in range(3):  # noqa: SIM110 - numba compiles no generators here
        if p[k] < min(a[k], b[k]) or p[k] > max(a[k], b[k]):
            return False
    return True
