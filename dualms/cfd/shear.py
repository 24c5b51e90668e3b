"""Shear rate at the wall from voxel velocities, without the noise of the stair steps.

Next to a wall the velocity along it is γ d + β d² with the distance d. Both vectors are fitted by least squares to the
cells within a few voxels, each at its true distance; the quadratic term keeps the curvature of the profile out of γ.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dualms.cfd.channels import VoxelExchanger
from dualms.cfd.mesh import ChannelMesh
from dualms.grid import Array
from dualms.measure.curvature import vertex_normals
from dualms.triangles import TriangleMesh

DEPTH = 2.5  # cells so many voxels off the wall take part
WINDOW = 0.8  # standard deviation, in voxels, of the weight by the place along the wall
SINGULAR = 1e-3  # of the fit's determinant: below, all cells are at one distance and the fit is linear


def wall_shear(exchanger: VoxelExchanger, channel: ChannelMesh, velocity_m_s: Array, wall: TriangleMesh) -> Array:
    """Shear rate vectors at a wall's vertices.

    Parameters
    ----------
    exchanger
        Geometry, with distances that are exact to ``DEPTH`` voxels off the wall.
    channel
        The fluid's cells.
    velocity_m_s
        (N, 3) of the cells.
    wall
        In metres, normals into the fluid.

    Returns
    -------
    (V, 3)
        1/s, tangential to the wall.
    """
    at = tuple(channel.cells.T)
    distance = (np.abs(exchanger.distance_m[at]) - exchanger.wall_m / 2) / exchanger.spacing_m
    weight = ((distance > 0) & (distance < DEPTH)).astype(float)
    points = ((wall.vertices - exchanger.origin_m) / exchanger.spacing_m).T

    def moment(values: Array) -> Array:
        lattice = np.zeros(exchanger.labels.shape)
        lattice[at] = weight * values
        smooth = ndimage.gaussian_filter(lattice, WINDOW, mode="constant")
        return np.asarray(ndimage.map_coordinates(smooth, points, order=1, mode="nearest"))

    second, third, fourth = (moment(distance**k)[:, None] for k in (2, 3, 4))
    first_of_u = np.stack([moment(distance * u) for u in velocity_m_s.T], axis=1)
    second_of_u = np.stack([moment(distance**2 * u) for u in velocity_m_s.T], axis=1)
    determinant = second * fourth - third**2
    fits = determinant > SINGULAR * second * fourth
    quadratic = (fourth * first_of_u - third * second_of_u) / np.where(fits, determinant, 1.0)
    linear = first_of_u / np.maximum(second, 1e-30)
    shear = np.where(fits, quadratic, linear) / exchanger.spacing_m
    normals = vertex_normals(wall.vertices, wall.faces)
    return np.asarray(shear - np.einsum("ij,ij->i", shear, normals)[:, None] * normals)
