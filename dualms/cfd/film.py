"""Thickness of the thermal layer on the wall: far below a voxel in oils, so it is computed on the wall's surface.

Close to the wall the temperature depends on the wall's shear rate alone (Lévêque 1928; Lighthill 1950, Proc. R. Soc.
A 202). A layer of thickness δ, the wall's conductivity over its heat transfer coefficient, carries heat in proportion
to γ δ² along the wall and takes up heat in proportion to α/δ:

    div(γ δ²) = C α / δ.

Along one streamline on the wall this is Lighthill's integral, with C = 2/(3 · 0.5384³) its coefficient too. Here it is
solved on the wall's triangles, so layers grow along the solved flow, thin out where it comes towards the wall, and
start anew at inlets and where it leaves the envelope. Where layers grow together the developed value of a duct of the
local half-width bounds δ, joined as the sum of cubes (Churchill and Usagi 1972).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dualms.cfd.channels import OUTSIDE, VoxelExchanger
from dualms.cfd.mesh import ChannelMesh
from dualms.cfd.wall import WallSheet
from dualms.grid import Array
from dualms.triangles import TriangleMesh

Index = NDArray[np.int64]

LEVEQUE = 1 / (9 ** (1 / 3) * math.gamma(4 / 3))  # 0.5384
GROWTH = 2 / (3 * LEVEQUE**3)  # C above
DEVELOPED = 1.85  # half-width over δ in developed flow: 1.83 in a tube (Nu 3.66), 1.885 between plates (Nu 7.54)
ENTERING = 0.3  # cosine between the flow along the wall and the envelope's normal from which on it enters
SWEEPS, SETTLED = 100, 1e-4  # until a sweep changes the total conductance by less than this share


def film_thickness(
    exchanger: VoxelExchanger,
    channel: ChannelMesh,
    wall: WallSheet,
    shear_per_s: Array,
    pressure_pa: Array,
    diffusivity_m2_s: float,
) -> Array:
    """Conductivity over the heat transfer coefficient between each triangle and the mixed fluid.

    Parameters
    ----------
    exchanger, channel, wall
        Geometry of one fluid.
    shear_per_s
        (V, 3) shear rate at the wall's vertices.
    pressure_pa
        (N,) of the cells; it falls along the flow, which the sweeps follow.
    diffusivity_m2_s
        Of the fluid's temperature.

    Returns
    -------
    (F,)
        Metres.
    """
    developed = half_width(exchanger, channel, wall) / DEVELOPED
    inwards = _inwards(exchanger, wall.mesh.centroids)
    # Not thicker than developed: what has spread further belongs to the mixed core's temperature.
    layer = layer_thickness(wall.mesh, shear_per_s, diffusivity_m2_s, inwards, pressure_pa[wall.cell], developed)
    return np.asarray((layer**-3 + developed**-3) ** (-1 / 3))


def half_width(exchanger: VoxelExchanger, channel: ChannelMesh, wall: WallSheet) -> Array:
    """(F,) half the channel's width seen from each triangle: the greatest distance from any wall on the way inwards."""
    fluid = np.zeros(exchanger.labels.shape, dtype=bool)
    fluid[tuple(channel.cells.T)] = True
    # From a cell's centre to the nearest wall's face, less half of what the middle is off the centres.
    free = ndimage.distance_transform_edt(fluid | (exchanger.labels == OUTSIDE)) - 0.25
    crosses = wall.mesh.crosses
    normals = crosses / np.maximum(np.linalg.norm(crosses, axis=1), 1e-300)[:, None]
    points = (wall.mesh.centroids - exchanger.origin_m) / exchanger.spacing_m
    widest = np.full(len(points), 0.5)
    going = np.arange(len(points))
    for step in range(1, max(exchanger.labels.shape)):
        at = points[going] + (step - 0.5) * normals[going]
        here = ndimage.map_coordinates(free, at.T, order=1)
        within = ndimage.map_coordinates(fluid.view(np.uint8), at.T, order=0, output=np.uint8) > 0
        # As long as the wall that the ray started from is still the nearest one; the first steps may miss the cells.
        going, here = (values[(here > step - 2.0) & (within | (step < 3))] for values in (going, here))
        if len(going) == 0:
            break
        widest[going] = np.maximum(widest[going], here)
    return widest * exchanger.spacing_m


def _inwards(exchanger: VoxelExchanger, points_m: Array) -> Array:
    """(F, 3) unit normals of the envelope next to points, without its stair steps; any direction far from it."""
    points = ((points_m - exchanger.origin_m) / exchanger.spacing_m).T
    inside = (exchanger.labels != OUTSIDE).astype(float)
    slope = np.stack(
        [
            ndimage.map_coordinates(ndimage.gaussian_filter(inside, 1.0, order=order), points, order=1, mode="nearest")
            for order in np.eye(3, dtype=int)
        ],
        axis=1,
    )
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)[:, None])


def layer_thickness(
    wall: TriangleMesh,
    shear_per_s: Array,
    diffusivity_m2_s: float,
    inwards: Array,
    upstream: Array,
    limit_m: Array,
) -> Array:
    """Solve div(γ δ²) = C α / δ by first-order upwind finite volumes on triangles.

    Parameters
    ----------
    wall
        Open mesh, metres.
    shear_per_s
        (V, 3) tangential shear rate.
    diffusivity_m2_s
        α.
    inwards
        (F, 3) direction away from the mesh's true border. Where the flow enters that way the layer starts at zero;
        where it runs along the border it is as thick beyond a saw-tooth edge as inside.
    upstream
        (F,) a number that falls along the flow: the first sweep visits triangles from high to low.
    limit_m
        (F,) largest thickness.

    Returns
    -------
    (F,)
        Metres.
    """
    source, target, flux, out = _fluxes(wall, shear_per_s, inwards)
    order = np.argsort(target, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(target, minlength=len(wall.faces)))])
    source, flux = source[order], flux[order]
    areas = wall.areas
    growth = GROWTH * diffusivity_m2_s * areas
    thickness = limit_m.astype(float)
    visit = np.argsort(-upstream, kind="stable")
    before = 0.0
    for _ in range(SWEEPS):
        _sweep(visit, starts, source, flux, out, growth, limit_m, thickness)
        now = float((areas / thickness).sum())
        if abs(now - before) <= SETTLED * now:
            break
        before, visit = now, visit[::-1]
    return thickness


def _fluxes(wall: TriangleMesh, shear: Array, inwards: Array) -> tuple[Index, Index, Array, Array]:
    """Fluxes of shear: the triangles that each leads from and to, its size, and for each triangle all that leaves."""
    count = len(wall.faces)
    edges = np.concatenate([wall.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    owner = np.tile(np.arange(count), 3)
    normals = wall.crosses / np.maximum(2 * wall.areas, 1e-300)[:, None]
    # Outward in the triangle's plane, as long as the edge.
    outward = np.cross(wall.vertices[edges[:, 1]] - wall.vertices[edges[:, 0]], normals[owner])
    across = shear[edges].mean(axis=1)
    key = np.sort(edges, axis=1) @ np.array([len(wall.vertices), 1])
    order = np.argsort(key, kind="stable")
    twins = np.flatnonzero(np.diff(key[order]) == 0)
    a, b = order[twins], order[twins + 1]
    flux = np.einsum("ij,ij->i", across[a], (outward[a] - outward[b]) / 2)
    source, target = np.where(flux > 0, owner[a], owner[b]), np.where(flux > 0, owner[b], owner[a])
    size = np.abs(flux)
    out = np.bincount(source, size, minlength=count).astype(float)

    border = np.ones(len(edges), dtype=bool)
    border[a] = border[b] = False
    flux = np.einsum("ij,ij->i", across[border], outward[border])
    out += np.bincount(owner[border], np.maximum(flux, 0), minlength=count)
    entering = np.einsum("ij,ij->i", inwards[owner[border]], across[border])
    steep = entering > ENTERING * np.linalg.norm(across[border], axis=1)
    missing = np.bincount(owner[border], np.where(steep, 0.0, np.maximum(-flux, 0)), minlength=count)
    # What comes in along the border is as it is in the triangle's neighbours inside.
    one, other = np.concatenate([owner[a], owner[b]]), np.concatenate([owner[b], owner[a]])
    share = missing[one] / np.bincount(one, minlength=count)[one]
    used = share > 0
    return (
        np.concatenate([source, other[used]]),
        np.concatenate([target, one[used]]),
        np.concatenate([size, share[used]]),
        out,
    )


@numba.njit(cache=True)
def _sweep(
    visit: Index,
    starts: Index,
    source: Index,
    flux: Array,
    out: Array,
    growth: Array,
    limit: Array,
    thickness: Array,
) -> None:
    """One Gauss-Seidel sweep: δ of each triangle from out · δ³ - in · δ - C α A = 0, which has one positive root."""
    for face in visit:
        carried = 0.0
        for k in range(starts[face], starts[face + 1]):
            carried += flux[k] * thickness[source[k]] ** 2
        o, g, top = out[face], growth[face], limit[face]
        if o * top**3 - carried * top - g <= 0:
            thickness[face] = top
            continue
        x = math.sqrt(carried / o) + (g / o) ** (1 / 3)  # not below the root: Newton falls towards it
        for _ in range(30):
            step = (o * x**3 - carried * x - g) / (3 * o * x**2 - carried)
            x -= step
            if abs(step) < 1e-7 * x:
                break
        thickness[face] = x
