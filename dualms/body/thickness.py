"""Wall thickness that varies over the body: given along a direction or at points, interpolated between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualms.domain import Domain
from dualms.grid import Grid
from dualms.spec import GradedAlong, Unit, WallGraded

Array = NDArray[np.float64]

NEIGHBOURS = 4_000_000  # pairs of a voxel and a given point that are weighed at a time


@dataclass(frozen=True)
class GradedWall:
    """A thickness at every point, unit-cube units.

    Parameters
    ----------
    places
        (K, 3) points where the thickness is given; with ``direction``, (K, 1) rising positions along it.
    thicknesses
        (K,) thickness at each.
    direction
        (3,) unit vector, or None for points in space.
    """

    places: Array
    thicknesses: Array
    direction: Array | None

    def __post_init__(self) -> None:
        if len(self.places) != len(self.thicknesses) or (self.thicknesses <= 0).any():
            raise ValueError("a graded wall needs a positive thickness at each of its places")

    @classmethod
    def of(cls, spec: WallGraded, units: Unit, domain: Domain) -> GradedWall:
        """The specification's thicknesses in the unit-cube frame."""
        k = units.metres / domain.scale_m
        graded = spec.graded
        if isinstance(graded, GradedAlong):
            vector = np.array(graded.direction, dtype=float)
            direction = vector / np.linalg.norm(vector)
            places, thicknesses = np.array(graded.stations, dtype=float).T
            shift = float(domain.offset_m @ direction) / domain.scale_m
            return cls((k * places - shift)[:, None], k * thicknesses, direction)
        points = np.array([point for point, _ in graded.points], dtype=float)
        thicknesses = np.array([thickness for _, thickness in graded.points], dtype=float)
        return cls(k * points - domain.offset_m / domain.scale_m, k * thicknesses, None)

    @property
    def most(self) -> float:
        """The greatest thickness."""
        return float(self.thicknesses.max())

    def at(self, points: Array) -> Array:
        """(P,) thickness at points (P, 3): linear along a direction, else weighted by 1/distance² (Shepard 1968)."""
        if self.direction is not None:
            return np.asarray(np.interp(points @ self.direction, self.places[:, 0], self.thicknesses))
        found = np.empty(len(points))
        chunk = max(1, NEIGHBOURS // len(self.places))
        for start in range(0, len(points), chunk):
            squared = ((points[start : start + chunk, None] - self.places) ** 2).sum(axis=2)
            weight = 1 / np.maximum(squared, 1e-18)
            found[start : start + chunk] = weight @ self.thicknesses / weight.sum(axis=1)
        return found


Wall = float | GradedWall


def thickness_at(wall: Wall, points: Array) -> Array:
    """(P,) thickness of a wall at points (P, 3), unit-cube units."""
    return wall.at(points) if isinstance(wall, GradedWall) else np.full(len(points), wall)


def greatest(wall: Wall) -> float:
    """The greatest thickness of a wall, unit-cube units."""
    return wall.most if isinstance(wall, GradedWall) else wall


def least(wall: Wall) -> float:
    """The least thickness of a wall, unit-cube units."""
    return float(wall.thicknesses.min()) if isinstance(wall, GradedWall) else wall


def mean_thickness(wall: Wall, domain: Domain, grid: Grid) -> float:
    """Mean thickness over the domain, unit-cube units."""
    return float(wall.at(grid.points(domain.inside(grid))).mean()) if isinstance(wall, GradedWall) else wall
