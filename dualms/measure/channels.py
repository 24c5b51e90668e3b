"""What a fluid meets on its way: narrowest passage, dead ends, and whether hot and cold touch, on the voxel grid."""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from dualms.domain import Domain
from dualms.flow import potential
from dualms.grid import Grid, thinned

Mask = NDArray[np.bool_]
PRECISION_VOXELS = 0.05  # of a passage's radius: distances are right to half a voxel
DEAD = 0.02  # of the median speed of a potential flow: slower counts as a dead end
VOXELS_AT_MOST = 200_000  # a fluid's voxels for the potential flow; a finer grid is halved


@dataclass(frozen=True)
class Channel:
    """Figures of one fluid's channel, unit-cube units.

    Parameters
    ----------
    connected
        Whether one face-connected region of voxels touches every port.
    dead_end_fraction
        Share of the volume where a potential flow from inlets to outlets is slower than 2 % of its median speed.
    min_width
        Width that 99 % of the channel's middle exceeds: twice the first percentile of the distance to the wall over
        its local maxima.
    passage
        Diameter of the largest ball that gets from the inlets to the outlets.
    """

    connected: bool
    dead_end_fraction: float
    min_width: float
    passage: float


def measure_channel(domain: Domain, room: Mask, grid: Grid, fluid: int) -> Channel:
    """Measure one fluid's channel.

    Parameters
    ----------
    domain
        For its ports.
    room
        Voxels of the fluid.
    grid
        Their grid.
    fluid
        1 hot, -1 cold.

    Notes
    -----
    Distances are right to half a voxel.
    """
    regions, _ = ndimage.label(room)
    ports = [port for port in domain.ports if port.fluid == fluid]
    inlets, outlets = (
        [_at_port(port.samples - grid.spacing * port.normal, room, grid) for port in ports if port.inlet == inlet]
        for inlet in (True, False)
    )
    touched = [set(regions[tuple(voxels.T)].tolist()) for voxels in (*inlets, *outlets)]
    common = set.intersection(*touched) - {0}
    if not common:
        return Channel(False, 1.0, 0.0, 0.0)
    region = regions == min(common)
    radius = (edt.edt(region, parallel=0) - 0.5) * grid.spacing
    source, sink = (np.concatenate([v[region[tuple(v.T)]] for v in ports]) for ports in (inlets, outlets))
    middle = region & (radius == ndimage.maximum_filter(radius, size=3)) & (radius > grid.spacing)
    width = 2 * float(np.quantile(radius[middle], 0.01)) if middle.any() else 2 * float(radius.max())
    return Channel(
        connected=True,
        dead_end_fraction=_dead_ends(region, source, sink),
        min_width=width,
        passage=_passage(radius, grid.spacing, source, sink),
    )


def _at_port(points: NDArray[np.float64], room: Mask, grid: Grid) -> NDArray[np.int64]:
    """(K, 3) voxels of a fluid next to points on a port, no further than two voxels beyond the nearest."""
    points = thinned(points, 0.5 * grid.spacing)  # samples are much finer than most grids
    found = np.zeros((0, 3), dtype=np.int64)
    for reach in (8, 32, max(room.shape)):
        low = np.maximum(grid.nearest(points.min(axis=0)[None])[0] - reach, 0)
        high = grid.nearest(points.max(axis=0)[None])[0] + reach + 1
        inside = low + np.argwhere(room[tuple(slice(a, b) for a, b in zip(low, high, strict=True))])
        if len(inside) == 0:
            continue
        gap, nearest = cKDTree(grid.origin + grid.spacing * inside).query(points)
        limit = gap.min() + 2 * grid.spacing
        found = inside[np.unique(nearest[gap <= limit])]
        if limit < reach * grid.spacing:
            break  # what lies further out cannot be nearer to a point than that
    return found


def _dead_ends(region: Mask, source: NDArray[np.int64], sink: NDArray[np.int64]) -> float:
    if region.sum() > VOXELS_AT_MOST:
        coarse = region[: region.shape[0] // 2 * 2, : region.shape[1] // 2 * 2, : region.shape[2] // 2 * 2]
        blocks = coarse.reshape(coarse.shape[0] // 2, 2, coarse.shape[1] // 2, 2, coarse.shape[2] // 2, 2)
        half = blocks.sum(axis=(1, 3, 5)) >= 4
        regions, _ = ndimage.label(half)
        largest = regions == np.bincount(regions.ravel())[1:].argmax() + 1
        ends = []
        for voxels in (source, sink):
            halved = np.unique(np.minimum(voxels // 2, np.array(largest.shape) - 1), axis=0)
            ends.append(halved[largest[tuple(halved.T)]])
        if min(len(end) for end in ends) == 0:
            return 1.0
        return _dead_ends(largest, ends[0], ends[1])
    both = {tuple(v) for v in source.tolist()} & {tuple(v) for v in sink.tolist()}
    keep = [np.array([v for v in voxels.tolist() if tuple(v) not in both]) for voxels in (source, sink)]
    if min(len(k) for k in keep) == 0:
        return 0.0  # inlet and outlet are one place: no way between them to be off
    _, velocity = potential(region, keep[0], keep[1])
    speed = np.linalg.norm(velocity, axis=1)
    return float((speed < DEAD * np.median(speed)).mean())


def _passage(radius: NDArray[np.float64], spacing: float, source: NDArray[np.int64], sink: NDArray[np.int64]) -> float:
    """Twice the largest radius at which the voxels with at least that radius still join source and sink.

    A ball comes in from outside, so what lies within the widest ball's radius of a port counts as open.
    """
    low, high = 0.0, float(radius.max())
    near = (_around(radius.shape, source, high / spacing) | _around(radius.shape, sink, high / spacing)) & (radius > 0)
    while high - low > PRECISION_VOXELS * spacing:
        middle = (low + high) / 2
        regions, _count = ndimage.label((radius >= middle) | near)
        ends = [set(regions[tuple(voxels.T)].tolist()) - {0} for voxels in (source, sink)]
        low, high = (middle, high) if ends[0] & ends[1] else (low, middle)
    return 2 * low


def _around(shape: tuple[int, ...], voxels: NDArray[np.int64], reach: float) -> Mask:
    """Which voxels of a grid lie within ``reach`` voxels of the given (K, 3)."""
    low = np.maximum(voxels.min(axis=0) - int(reach) - 1, 0)
    box = tuple(slice(a, b) for a, b in zip(low, voxels.max(axis=0) + int(reach) + 2, strict=True))
    found = np.zeros(shape, dtype=bool)
    outside = np.ones(found[box].shape, dtype=bool)
    outside[tuple((voxels - low).T)] = False
    found[box] = edt.edt(outside, parallel=0) <= reach
    return found
