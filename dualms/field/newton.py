"""The last stretch to H = 0: Newton's method on the surface itself, regularised (Levenberg-Marquardt).

A surface that moves along its normal by d changes its 2H by -Δd - |A|²d. Each step solves for the least motion that
cancels 2H in the sense of least squares, on a mesh of the zero set, and moves the samples by that motion continued
along the normals. The mesh only carries the linear problem: the curvature that is cancelled is that of the samples,
so the result has no trace of the triangles. The surface goes on beyond the wall, and its contact there is free:
minimal surfaces at 90° to a freeform wall need not exist near the start, while free ones do.

References
----------
Levenberg 1944; for μ as the squared residual, Yamashita and Fukushima 2001, "On the rate of convergence of the
Levenberg-Marquardt method".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from dualms.field import topology
from dualms.field.sheet import Array, Floats, Jet, Mask, Sheet, sample

BEYOND_VOXELS = 4
"""How far beyond the wall the surface is carried along."""
_DAMPING = 400.0
_MOST_DAMPING = 30.0
"""μ is the first times the squared residual, at most the second."""
_LONGEST = 0.06
"""Longest motion in a step over the gap between the skeletons."""
_OUTLIER = 10.0
"""Over the median |2H|: what is cancelled at once; the start is kinked where it was continued beyond the wall."""
_STIFF = 1000.0
_MOST_RISE = 1.1
"""Of the energy in a step that lowers the mean |H|: the tail must not pay for the middle."""
_RELAX = np.float32(0.9)
_BEYOND_WEIGHT = 0.03
_PIN = np.float32(0.02)


@dataclass(frozen=True)
class Slab:
    """Where the surface lives.

    Parameters
    ----------
    inside
        (nx, ny, nz) voxels of the domain, whose colours keep their topology.
    depth
        (nx, ny, nz) signed distance to the wall in voxels, positive inside, exact within five voxels.
    gap
        Way between the skeletons, in voxels.
    periodic
        Whether the box continues across its faces.
    """

    inside: Mask
    depth: Floats
    gap: float
    periodic: bool


def straighten(
    values: Floats, slab: Slab, steps: int, tolerance: float, each: Callable[[int, float, int], None]
) -> Floats:
    """Bring a zero set towards H = 0.

    Parameters
    ----------
    values
        (nx, ny, nz) distance-like samples, in voxels.
    slab
        The domain on the same grid.
    steps
        At most so many.
    tolerance
        Median of |2H| times the gap at which it ends.
    each
        Called after every step with its number, ∫(2H)² over the surface in the domain, and the number of voxels that
        would have changed the topology.

    Returns
    -------
    Floats
        The samples of least mean |H| on the way; their topology inside the domain is that of the start.

    Notes
    -----
    One sparse factorisation a step: 1.3 s of CPU time at 40,000 vertices.
    """
    hot = (values > 0) & slab.inside
    best = _State.of(values, hot, slab)
    # Where a step had to be taken back, the surface is stiff for a while, and its surroundings adapt.
    held = np.zeros(values.shape, dtype=np.float32)
    caution = 1.0
    for n in range(1, steps + 1):
        if best.typical < tolerance:
            break
        motion = _motion(best, slab, caution, sample(held, best.sheet.points, slab.periodic))
        moved = best.values - _continued(motion, best, slab)
        hot = best.hot.copy()
        kept = topology.follow(hot, moved, slab.inside, slab.periodic)
        held *= _RELAX
        if len(kept):
            near = _near(kept, values.shape)
            held = np.maximum(held, near)
            moved = moved * (1 - near) + best.values * near
            _pin(moved, hot, topology.follow(hot, moved, slab.inside, slab.periodic))
        trial = _State.of(moved, hot, slab)
        better = trial.mean < best.mean and trial.energy < _MOST_RISE * best.energy
        caution = max(1.0, caution / 2) if better else 4 * caution
        best = trial if better else best
        each(n, best.energy, len(kept))
    return best.values


@dataclass(frozen=True)
class _State:
    """A surface and its figures within the domain: ∫(2H)², and mean and median of |2H| times the gap."""

    values: Floats
    hot: Mask
    jet: Jet
    sheet: Sheet
    energy: float
    mean: float
    typical: float

    @classmethod
    def of(cls, values: Floats, hot: Mask, slab: Slab) -> _State:
        jet = Jet.of(values)
        sheet = Sheet.of(values, jet, slab.depth > -BEYOND_VOXELS, slab.periodic)
        inside = sample(slab.depth, sheet.points, slab.periodic) > 0
        bend, mass = np.abs(sheet.bend[inside]), sheet.mass[inside]
        mean = slab.gap * float(np.average(bend, weights=mass))
        return cls(values, hot, jet, sheet, float(bend**2 @ mass), mean, slab.gap * float(np.median(bend)))


def _motion(state: _State, slab: Slab, caution: float, held: Array) -> Array:
    """(V,) motion along the normal in voxels: regularised least squares, bounded."""
    sheet = state.sheet
    # In units of the gap, so that the damping means the same on every grid.
    mass = sheet.mass / slab.gap**2
    most = _OUTLIER * state.typical
    bend = np.clip(sheet.bend * slab.gap, -most, most)
    square = np.minimum(sheet.square * slab.gap**2, 200.0)
    depth = sample(slab.depth, sheet.points, slab.periodic)
    weight = mass * np.clip((depth + BEYOND_VOXELS - 1) / 2, _BEYOND_WEIGHT, 1)
    change = (sparse.diags_array(1 / mass) @ sheet.stiffness - sparse.diags_array(square)).tocsr()
    damping = caution * min(_DAMPING * state.typical**2, _MOST_DAMPING) * mass * (1 + _STIFF * held)
    normal = change.T @ sparse.diags_array(weight) @ change + sparse.diags_array(damping)
    factors = splu(normal.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    motion = factors.solve(-(change.T @ (weight * bend)))
    return np.asarray(slab.gap * _LONGEST * np.tanh(motion / _LONGEST))


def _continued(motion: Array, state: _State, slab: Slab) -> Floats:
    """(nx, ny, nz) change of the samples: the motion at the foot of each voxel on the surface, times the slope."""
    values, jet, sheet = state.values, state.jet, state.sheet
    shape = values.shape
    low = np.floor(sheet.points).astype(np.int64)
    part = sheet.points - low
    sums = np.zeros((2, int(np.prod(shape))))
    for corner in np.ndindex(2, 2, 2):
        weight = sheet.mass * np.prod(np.where(corner, part, 1 - part), axis=1)
        at = np.ravel_multi_index(tuple((low + corner).T), shape, mode="wrap" if slab.periodic else "clip")
        for total, what in zip(sums, (weight * motion, weight), strict=True):
            total += np.bincount(at, what, total.size)
    mode = "wrap" if slab.periodic else "constant"
    moved, weight = (ndimage.gaussian_filter(total.reshape(shape), 0.7, mode=mode, truncate=6) for total in sums)
    mean = moved / np.maximum(weight, 1e-9 * weight.max())
    band = (np.abs(values) < 0.7 * slab.gap) & (slab.depth > -BEYOND_VOXELS - 2)
    normal = np.stack([c[band] for c in jet.normal], axis=1)
    off = np.clip(values[band] / jet.slope[band], -0.7 * slab.gap, 0.7 * slab.gap)
    foot = np.argwhere(band) - off[:, None] * normal
    change = np.zeros(shape, dtype=np.float32)
    change[band] = sample(mean, foot, slab.periodic) * np.clip(jet.slope[band], 0.5, 1.5)
    return change


def _near(kept: NDArray[np.int64], shape: tuple[int, ...]) -> Floats:
    """(nx, ny, nz) 1 at voxels and their neighbours, falling to 0 in four voxels."""
    free = np.ones(shape, dtype=bool)
    free[tuple(kept.T)] = False
    return np.asarray(np.clip((4 - ndimage.distance_transform_edt(free)) / 3, 0, 1), dtype=np.float32)


def _pin(values: Floats, hot: Mask, kept: NDArray[np.int64]) -> None:
    at = tuple(kept.T)
    values[at] = np.where(hot[at], _PIN, -_PIN)
