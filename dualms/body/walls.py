"""The separating wall: all points nearer to the surface than half its thickness, by true distance (paper, sec. 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dualms.body.offset import offset_surface
from dualms.body.thickness import GradedWall, Wall, thickness_at
from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import WallTooThick
from dualms.spec import Unit, WallGraded, WallSpec, WallThickness
from dualms.surface import Surface, level_set
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]
Values = NDArray[np.float32]

SAG = 0.025  # of half the thickness: how far the middle of an edge may lie off


def widest_wall(spec: WallSpec, units: Unit, domain: Domain) -> float | None:
    """The greatest thickness asked for, unit-cube units; None where a share is given."""
    if isinstance(spec, WallThickness):
        return _asked(spec, units, domain)
    return GradedWall.of(spec, units, domain).most if isinstance(spec, WallGraded) else None


def graded_wall(spec: WallSpec, units: Unit, domain: Domain) -> GradedWall | None:
    """The wall that a specification grades; None where it is even."""
    return GradedWall.of(spec, units, domain) if isinstance(spec, WallGraded) else None


def wall_thickness(spec: WallSpec, units: Unit, domain: Domain, surface: Surface) -> Wall:
    """Thickness of the wall in unit-cube units.

    Parameters
    ----------
    spec
        The thickness, in ``units``, constant or graded, or the share of the domain's volume that the wall takes.
    units
        Unit of the specification.
    domain
        The envelope.
    surface
        Holds the distances to the separating surface and to the envelope.

    Returns
    -------
    Wall
        The thickness, or a graded wall. A share is first met on the voxels, then corrected once by the exact volumes.

    Raises
    ------
    WallTooThick
        If the share cannot be reached within the band where distances are known.
    """
    if isinstance(spec, WallThickness):
        return _asked(spec, units, domain)
    if isinstance(spec, WallGraded):
        return GradedWall.of(spec, units, domain)
    if wall_share(surface, surface.band) < spec.volume_fraction:
        raise WallTooThick(
            f"A wall of {100 * spec.volume_fraction:.3g} % of the domain would be thicker than "
            f"{2 * surface.band * domain.scale_m / units.metres:.3g} {units.value}.",
            advice="Ask for a smaller volume_fraction or more sites.",
            measured={"volume_fraction": spec.volume_fraction},
        )
    half: float = brentq(lambda h: wall_share(surface, h) - spec.volume_fraction, 0.0, surface.band, xtol=1e-6)
    envelope = Solid.of(TriangleMesh(domain.vertices, domain.faces))
    left = sum((side & envelope).volume for side in channels(surface, 2 * half, 0.0))
    return 2 * half * spec.volume_fraction / (1 - left / envelope.volume)


def _asked(spec: WallThickness, units: Unit, domain: Domain) -> float:
    return spec.thickness * units.metres / domain.scale_m


def wall_share(surface: Surface, half: float | Values) -> float:
    """Share of the domain within ``half`` (unit-cube units) of the surface; cut voxels count by their part.

    ``half`` may hold a value for every voxel of the surface's grid.
    """
    spacing = surface.grid.spacing
    voxels = surface.depth > -spacing
    inside = np.clip(surface.depth[voxels] / spacing + 0.5, 0, 1)
    reach = np.broadcast_to(half, voxels.shape)[voxels]
    # Where both sides of a thin wall lie in one voxel, the voxel holds at most the wall's own thickness.
    walled = np.clip(
        (reach - np.abs(surface.distance[voxels])) / spacing + 0.5, 0, np.minimum(1.0, 2 * reach / spacing)
    )
    return float((inside * walled).sum() / inside.sum())


def channels(surface: Surface, wall: Wall, reach: float) -> tuple[Solid, Solid]:
    """The two sides of the wall, not yet cut to the domain: hot and cold.

    Parameters
    ----------
    surface
        Distance to the separating surface, exact beyond half the greatest thickness by two voxels.
    wall
        Thickness, unit-cube units.
    reach
        How far outside the envelope the sides are wanted exact.
    """
    half = half_on_grid(surface, wall)
    # Beyond the reach they end: what is cut off later need not be made.
    near = surface.depth + np.float32(reach + surface.grid.spacing)
    sides = []
    for name, sign in (("hot", 1), ("cold", -1)):
        beyond = sign * surface.distance - np.float32(half)
        side = level_set(np.where(near > 0, beyond, np.minimum(beyond, near)), surface.grid)
        if len(side.faces) == 0:
            raise WallTooThick(
                f"A wall of {2 * np.max(half):.3g} of the domain's longest side leaves no room for the {name} fluid.",
                advice="Make the wall thinner or use fewer sites.",
                measured={"wall_over_longest_side": float(2 * np.max(half))},
            )
        sides.append(Solid.of(offset_surface(side, surface, lambda p: thickness_at(wall, p) / 2, SAG, reach)))
    return sides[0], sides[1]


def half_on_grid(surface: Surface, wall: Wall) -> float | Values:
    """Half the thickness: one value, or one for every voxel of the surface's grid."""
    if isinstance(wall, GradedWall):
        values = (wall.at(surface.grid.points()) / 2).astype(np.float32)
        return np.asarray(values.reshape(surface.grid.shape))
    return wall / 2
