"""The finite-volume mesh of one fluid: its voxels as cells, in the face-based layout of OpenFOAM's polyMesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualms.cfd.channels import OUTSIDE, STEPS, Index, VoxelExchanger, boundary_faces
from dualms.grid import Array

PATCHES = ("inlet", "outlet", "wall", "envelope")

# Corners of a unit voxel's faces, counter-clockwise seen from outside, in the order of ``STEPS``.
_CORNERS = np.array(
    [
        [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
    ]
)


@dataclass(frozen=True)
class ChannelMesh:
    """Cells and faces of one fluid.

    Parameters
    ----------
    cells
        (N, 3) int64 lattice index of each cell, in C order.
    points_m
        (P, 3) corners.
    faces
        (F, 4) int64 corner indices; a face's normal points out of its owner. Internal faces first, ordered by owner and
        neighbour; then the patches' faces.
    owner
        (F,) int64 cell of each face.
    neighbour
        (I,) int64 other cell of the internal faces, always higher than the owner.
    direction
        (F,) int64 0…5, the normal's direction as in ``channels.STEPS``.
    starts
        Index of the first face of each of ``PATCHES``, and F.
    inlet_normals
        (K, 3) outward normal of the port that each inlet face lies in.
    spacing_m
        Edge of a cell.
    """

    cells: Index
    points_m: Array
    faces: Index
    owner: Index
    neighbour: Index
    direction: Index
    starts: tuple[int, int, int, int, int]
    inlet_normals: Array
    spacing_m: float

    def __post_init__(self) -> None:
        if self.faces.shape != (len(self.owner), 4) or len(self.direction) != len(self.owner):
            raise ValueError("faces (F, 4), owner (F,) and direction (F,) must agree")
        if len(self.neighbour) != self.starts[0] or self.starts[-1] != len(self.owner):
            raise ValueError("internal faces must come first and the patches cover the rest")

    def patch(self, name: str) -> slice:
        """Range of a patch's faces."""
        k = PATCHES.index(name)
        return slice(self.starts[k], self.starts[k + 1])

    @property
    def face_area_m2(self) -> float:
        """Area of any face."""
        return self.spacing_m**2


def channel_mesh(exchanger: VoxelExchanger, fluid: int) -> ChannelMesh:
    """Take the voxels of one fluid as cells.

    Every face towards the outside is ``inlet``, ``outlet`` or adiabatic ``envelope``; every other boundary face is
    ``wall``, also one that the other fluid's voxel touches.
    """
    labels = exchanger.labels
    cells = np.argwhere(labels == fluid)
    number = np.full(labels.shape, -1, dtype=np.int64)
    number[tuple(cells.T)] = np.arange(len(cells))
    owner, neighbour, direction = _internal(number)
    openings = exchanger.openings(fluid)
    outer = boundary_faces(labels, fluid, (OUTSIDE,))
    wall = boundary_faces(labels, fluid, tuple(v for v in (1, -1, 2) if v != fluid))
    taken = np.isin(_key(outer, labels.shape), _key(np.concatenate([openings.inlet, openings.outlet]), labels.shape))
    patches = [openings.inlet, openings.outlet, wall, outer[~taken]]
    starts = np.cumsum([len(owner), *(len(p) for p in patches)])
    boundary = np.concatenate(patches)
    owner = np.concatenate([owner, number[tuple(boundary[:, :3].T)]])
    direction = np.concatenate([direction, boundary[:, 3]])
    points, faces = _corners(cells[owner], direction, labels.shape)
    return ChannelMesh(
        cells,
        exchanger.origin_m + exchanger.spacing_m * (points - 0.5),
        faces,
        owner,
        neighbour,
        direction,
        (int(starts[0]), int(starts[1]), int(starts[2]), int(starts[3]), int(starts[4])),
        openings.inlet_normals,
        exchanger.spacing_m,
    )


def _internal(number: NDArray[np.int64]) -> tuple[Index, Index, Index]:
    """Owner, neighbour and direction of the faces between two cells, in OpenFOAM's order."""
    owners, neighbours, directions = [], [], []
    for axis in range(3):
        low = np.moveaxis(number, axis, 0)[:-1]
        high = np.moveaxis(number, axis, 0)[1:]
        both = (low >= 0) & (high >= 0)
        owners.append(low[both])
        neighbours.append(high[both])
        directions.append(np.full(int(both.sum()), 2 * axis + 1))
    owner, neighbour, direction = (np.concatenate(v) for v in (owners, neighbours, directions))
    order = np.lexsort((neighbour, owner))
    return owner[order], neighbour[order], direction[order]


def _key(faces: Index, shape: tuple[int, ...]) -> Index:
    """One number for a face (K, 4) of the lattice."""
    return np.asarray(np.ravel_multi_index(tuple(faces.T), (*shape, len(STEPS))), dtype=np.int64)


def _corners(cells: Index, direction: Index, shape: tuple[int, ...]) -> tuple[Array, Index]:
    """Corners in use (P, 3) as lattice coordinates, and their indices (F, 4) for each face."""
    corners = cells[:, None, :] + _CORNERS[direction]
    size = tuple(n + 1 for n in shape)
    flat = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), size)
    used, faces = np.unique(flat, return_inverse=True)
    points = np.stack(np.unravel_index(used, size), axis=1).astype(float)
    return points, faces.reshape(-1, 4).astype(np.int64)
