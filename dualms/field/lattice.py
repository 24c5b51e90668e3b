"""The field problem on one voxel grid: the domain, the skeletons' voxels, and the distances to the skeletons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.domain import Domain
from dualms.errors import EmptySurface
from dualms.field import topology
from dualms.field.torus import Torus
from dualms.grid import Grid
from dualms.skeletons import Skeletons

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_DEPTH_VOXELS = 3
_GAP_RESOLUTION = 48


@dataclass(frozen=True)
class Lattice:
    """Domain and skeletons on voxels.

    Parameters
    ----------
    grid
        Voxels round the domain, four more on each side.
    depth
        (nx, ny, nz) float32 signed distance to the wall, positive inside, clipped to three voxels, unit-cube units.
    inside
        (nx, ny, nz) voxels of the domain.
    skeleton
        Voxels of the hot and of the cold skeleton.
    periodic
        Whether the box continues across its faces; then it has no wall.
    """

    grid: Grid
    depth: Floats
    inside: Mask
    skeleton: tuple[Mask, Mask]
    periodic: bool = False

    @classmethod
    def of(cls, domain: Domain | Torus, skeletons: Skeletons, resolution: int) -> Lattice:
        """Voxels of edge 1/resolution."""
        if isinstance(domain, Torus):
            grid = domain.grid(resolution)
            everywhere = np.ones(grid.shape, dtype=bool)
            depth = np.full(grid.shape, np.float32(_DEPTH_VOXELS * grid.spacing))
            nets = [
                topology.voxels_of(np.mod(points, 1), grid, everywhere) for points in (skeletons.hot, skeletons.cold)
            ]
            return cls(grid, depth, everywhere, (nets[0], nets[1]), periodic=True)
        grid = domain.grid(resolution, padding=4)
        depth = domain.depth(grid, _DEPTH_VOXELS * grid.spacing)
        inside = domain.inside(grid)
        tubes = (topology.voxels_of(skeletons.hot, grid, inside), topology.voxels_of(skeletons.cold, grid, inside))
        return cls(grid, depth, inside, tubes)

    @property
    def fraction(self) -> Floats:
        """(nx, ny, nz) float32 share of each voxel in the domain, as if the wall were flat and faced an axis."""
        return np.asarray(np.clip(0.5 + self.depth / self.grid.spacing, 0, 1), dtype=np.float32)

    def colouring(self, values: NDArray[np.floating]) -> Mask:
        """(nx, ny, nz) which voxels are hot by the sign of ``values``, once stray pockets are given away.

        Raises
        ------
        EmptySurface
            If a fluid has no voxel.
        """
        hot = np.asarray(values > 0)
        if not self.periodic:
            hot, _ = topology.without_pockets(hot, self.inside, self.skeleton)
        for name, some in (("hot", hot), ("cold", ~hot)):
            if not (some & self.inside).any():
                raise EmptySurface(
                    f"The {name} fluid owns no voxel of edge {self.grid.spacing:.4g} (longest side of the domain: 1).",
                    advice="Raise the field's resolution, or use fewer sites.",
                )
        return hot

    def distances(self, skeletons: Skeletons) -> tuple[Floats, Floats]:
        """Distances (nx, ny, nz) float32 to the hot and to the cold skeleton; 1 far outside the domain."""
        near = self.depth > -2 * self.grid.spacing
        points = self.grid.points(near)
        away = []
        for samples in (skeletons.hot, skeletons.cold):
            distance = np.full(self.grid.shape, np.float32(1))
            tree = cKDTree(np.mod(samples, 1), boxsize=1) if self.periodic else cKDTree(samples)
            distance[near] = tree.query(points, workers=-1)[0]
            away.append(distance)
        return away[0], away[1]

    def nearer_to_hot(self, skeletons: Skeletons) -> Mask:
        """(nx, ny, nz) voxels of the domain that are nearer to the hot skeleton than to the cold one."""
        tree = cKDTree(np.concatenate([skeletons.hot, skeletons.cold]))
        nearer = np.zeros(self.grid.shape, dtype=bool)
        nearer[self.inside] = tree.query(self.grid.points(self.inside), workers=-1)[1] < len(skeletons.hot)
        return nearer


def typical_gap(domain: Domain | Torus, skeletons: Skeletons) -> float:
    """Median over the domain of the way between the skeletons through a point: about the spacing of the sites."""
    lattice = Lattice.of(domain, skeletons, _GAP_RESOLUTION)
    to_hot, to_cold = lattice.distances(skeletons)
    return float(np.median((to_hot + to_cold)[lattice.inside]))


def colour(u: Floats, hot: Mask) -> None:
    """Give values the sign of a colouring where they have the other, in place, by mirroring them."""
    wrong = (u > 0) != hot
    u[wrong] = np.where(hot[wrong], 1, -1) * np.maximum(np.abs(u[wrong]), np.float32(1e-3))
