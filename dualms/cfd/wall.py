"""The separating wall as one fluid sees it: triangles on the true surface, each with the voxel that it heats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.cfd.channels import OUTSIDE, VoxelExchanger
from dualms.cfd.mesh import ChannelMesh
from dualms.grid import Array, Grid
from dualms.surface import level_set
from dualms.triangles import TriangleMesh

REACH = 1.8  # voxels from a triangle to its cell at most; beyond, the surface belongs to a dropped pocket
PAD = 3


@dataclass(frozen=True)
class WallSheet:
    """One fluid's side of the separating wall.

    Parameters
    ----------
    mesh
        Triangles in metres; their normals point into the fluid. Its border is a saw-tooth along the envelope.
    cell
        (F,) the fluid's voxel nearest to each triangle.
    """

    mesh: TriangleMesh
    cell: NDArray[np.int64]

    def __post_init__(self) -> None:
        if self.cell.shape != (len(self.mesh.faces),):
            raise ValueError("a wall needs one cell per triangle")

    @property
    def area_m2(self) -> Array:
        """(F,) areas."""
        return self.mesh.areas


def wall_sheet(exchanger: VoxelExchanger, channel: ChannelMesh, fluid: int) -> WallSheet:
    """The level set half a wall away from the separating surface, inside the envelope.

    Parameters
    ----------
    exchanger
        Geometry.
    channel
        The fluid's cells.
    fluid
        1 hot, -1 cold.
    """
    spacing = exchanger.spacing_m
    depth = (fluid * exchanger.distance_m - exchanger.wall_m / 2) / spacing
    # The level set is closed at the rim of its grid: that must be out of reach.
    padded = np.pad(depth.astype(np.float32), PAD, mode="edge")
    whole = level_set(padded, Grid(np.full(3, -PAD), 1.0, (padded.shape[0], padded.shape[1], padded.shape[2])))
    centroids = whole.centroids
    at = np.clip(np.rint(centroids).astype(int), 0, np.array(exchanger.labels.shape) - 1)
    inside = exchanger.labels[tuple(at.T)] != OUTSIDE
    away, cell = cKDTree(channel.cells).query(centroids, distance_upper_bound=REACH)
    keep = inside & np.isfinite(away)
    faces = whole.faces[keep][:, ::-1]  # the level set's normals point out of the fluid
    vertices = exchanger.origin_m + spacing * whole.vertices
    return WallSheet(TriangleMesh(vertices, faces), cell[keep].astype(np.int64))
