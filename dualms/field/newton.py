"""The last stretch to H = 0: Newton's method on the surface itself, regularised (Levenberg-Marquardt).

A surface that moves along its normal by d changes its 2H by -Δd - |A|²d. Each step solves for the least motion that
cancels 2H in the sense of least squares, on a mesh of the zero set, and moves the samples by that motion continued
along the normals. The mesh only carries the linear problem: the curvature that is cancelled is that of the samples,
so the result has no trace of the triangles. The surface goes on beyond the wall, and its contact there is free:
minimal surfaces at 90° to a freeform wall need not exist near the start, while free ones do.

How far a step is trusted is decided place by place: one that raises ∫(2H)² or would change the topology is taken back
there only, and damped there the more in the next steps. One damping for all is ruled by the few worst places.

References
----------
Levenberg 1944; for μ as the squared residual, Yamashita and Fukushima 2001, "On the rate of convergence of the
Levenberg-Marquardt method".
"""

from __future__ import annotations

import math
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
_LONGEST = 0.08
"""Longest motion in a step over the gap between the skeletons; the less where the damping was raised."""
_OUTLIER, _LEAST_OUTLIER = 10.0, 3.0
"""What is cancelled at once, over the median |2H|, and at least, times the gap: the start is kinked at the wall."""
_RISE, _RISE_RATIO = 0.3, 1.1
"""Of ∫(2H)² round a voxel, at which a step is taken back there."""
_WHOLE_RISE_RATIO = 1.02
"""Of ∫(2H)² over the whole surface, at which a step is taken back everywhere."""
_ROUND = 2.0
"""Width in voxels of what is round a voxel."""
_LEAST_CAUTION, _MOST_CAUTION = -1.0, 12.0
_MORE_CAUTION, _FORGOTTEN = 3.0, 0.5
"""Caution of 1 doubles the damping: the first is added where a step was taken back, the second goes in every step."""
_RAMP = 4.0
"""Depth in voxels from which curvature counts whole: at the wall itself the start is kinked."""
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
        Root mean square of 2H times the gap at which it ends.
    each
        Called after every step with its number, ∫(2H)² over the surface in the domain, and the number of voxels that
        would have changed the topology.

    Returns
    -------
    Floats
        The samples at the end; their topology inside the domain is that of the start.

    Notes
    -----
    One sparse factorisation a step: 1.5 s of CPU time at 60,000 vertices.
    """
    best = _State.of(values, (values > 0) & slab.inside, slab)
    caution = np.zeros(values.shape, dtype=np.float32)
    for n in range(1, steps + 1):
        if best.deviation < tolerance:
            break
        motion = _motion(best, slab, sample(caution, best.sheet.points, slab.periodic))
        trial, kept = _followed(best, best.values - _continued(motion, best, slab), slab)
        worse = trial.round(slab) > np.maximum(_RISE_RATIO * best.round(slab), best.round(slab) + _RISE)
        worse[tuple(kept.T)] = True
        near = _near(worse)
        if worse.any():
            trial, _ = _followed(best, trial.values * (1 - near) + best.values * near, slab)
        caution = np.clip(caution - _FORGOTTEN + (_MORE_CAUTION + _FORGOTTEN) * near, _LEAST_CAUTION, _MOST_CAUTION)
        if trial.energy < _WHOLE_RISE_RATIO * best.energy:
            best = trial
        else:
            caution += 2
        each(n, best.energy, len(kept))
    return best.values


@dataclass(frozen=True)
class _State:
    """A surface and its figures within the domain.

    ``energy`` is ∫(2H)² without the wall's strip; ``deviation`` its root mean and ``typical`` the median of |2H|, times
    the gap.
    """

    values: Floats
    hot: Mask
    jet: Jet
    sheet: Sheet
    energy: float
    deviation: float
    typical: float

    @classmethod
    def of(cls, values: Floats, hot: Mask, slab: Slab) -> _State:
        jet = Jet.of(values)
        sheet = Sheet.of(values, jet, slab.depth > -BEYOND_VOXELS, slab.periodic)
        depth = sample(slab.depth, sheet.points, slab.periodic)
        weight = np.clip(depth / _RAMP, 0, 1) * sheet.mass
        energy = float(weight @ sheet.bend**2)
        deviation = slab.gap * math.sqrt(energy / max(float(weight.sum()), 1.0))
        typical = slab.gap * float(np.median(np.abs(sheet.bend[depth > 0])))
        return cls(values, hot, jet, sheet, energy, deviation, typical)

    def round(self, slab: Slab) -> Floats:
        """(nx, ny, nz) ∫(2H)² over the surface round each voxel; at the wall a tenth counts."""
        sheet, shape = self.sheet, self.values.shape
        depth = sample(slab.depth, sheet.points, slab.periodic)
        weight = np.where(depth > -1, np.clip(depth / _RAMP, 0.1, 1), 0) * sheet.mass * sheet.bend**2
        nearest = np.rint(sheet.points).astype(np.int64)
        at = np.ravel_multi_index(tuple(nearest.T), shape, mode="wrap" if slab.periodic else "clip")
        each = np.bincount(at, weight, self.values.size).reshape(shape).astype(np.float32)
        spread = ndimage.gaussian_filter(each, _ROUND, mode="wrap" if slab.periodic else "constant")
        return np.asarray(spread * (2 * np.pi * _ROUND**2) ** 1.5)


def _followed(start: _State, values: Floats, slab: Slab) -> tuple[_State, NDArray[np.int64]]:
    """The state of new samples, held where they would change the topology, and these voxels (K, 3)."""
    hot, held = start.hot.copy(), values.copy()
    kept = topology.follow(hot, held, slab.inside, slab.periodic, sealed=True)
    at = tuple(kept.T)
    held[at] = np.where(hot[at], _PIN, -_PIN)
    return _State.of(held, hot, slab), kept


def _motion(state: _State, slab: Slab, caution: Array) -> Array:
    """(V,) motion along the normal in voxels: regularised least squares, bounded."""
    sheet = state.sheet
    # In units of the gap, so that the damping means the same on every grid.
    mass = sheet.mass / slab.gap**2
    most = max(_OUTLIER * state.typical, _LEAST_OUTLIER)
    bend = np.clip(sheet.bend * slab.gap, -most, most)
    square = np.minimum(sheet.square * slab.gap**2, 200.0)
    depth = sample(slab.depth, sheet.points, slab.periodic)
    weight = mass * np.clip((depth + BEYOND_VOXELS - 1) / 2, _BEYOND_WEIGHT, 1)
    change = (sparse.diags_array(1 / mass) @ sheet.stiffness - sparse.diags_array(square)).tocsr()
    damping = 2**caution * min(_DAMPING * state.typical**2, _MOST_DAMPING) * mass
    normal = change.T @ sparse.diags_array(weight) @ change + sparse.diags_array(damping)
    factors = splu(normal.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    motion = factors.solve(-(change.T @ (weight * bend)))
    longest = _LONGEST * 2 ** -(np.clip(caution, 0, 6) / 2)
    return np.asarray(slab.gap * longest * np.tanh(motion / longest))


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


def _near(some: Mask) -> Floats:
    """(nx, ny, nz) 1 at voxels and their neighbours, falling to 0 in six voxels."""
    if not some.any():
        return np.zeros(some.shape, dtype=np.float32)
    return np.asarray(np.clip((6 - ndimage.distance_transform_edt(~some)) / 5, 0, 1), dtype=np.float32)
