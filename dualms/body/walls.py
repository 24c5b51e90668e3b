"""The separating wall: all points nearer to the surface than half its thickness, by true distance (paper, sec. 3)."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import WallTooThick
from dualms.spec import Unit, WallFraction, WallThickness
from dualms.surface import Surface, level_set
from dualms.triangles import TriangleMesh

Values = NDArray[np.float32]


def wall_thickness(spec: WallThickness | WallFraction, units: Unit, domain: Domain, surface: Surface) -> float:
    """Thickness of the wall in unit-cube units.

    Parameters
    ----------
    spec
        Either the thickness, in ``units``, or the share of the domain's volume that the wall takes.
    units
        Unit of the specification.
    domain
        The envelope.
    surface
        Holds the distances to the separating surface and to the envelope.

    Returns
    -------
    float
        The thickness. A share is first met on the voxels, then corrected once by the exact volumes.

    Raises
    ------
    WallTooThick
        If the share cannot be reached within the band where distances are known.
    """
    if isinstance(spec, WallThickness):
        return spec.thickness * units.metres / domain.scale_m
    if wall_share(surface, surface.band) < spec.volume_fraction:
        raise WallTooThick(
            f"A wall of {100 * spec.volume_fraction:.3g} % of the domain would be thicker than "
            f"{2 * surface.band * domain.scale_m / units.metres:.3g} {units.value}.",
            advice="Ask for a smaller volume_fraction or more sites.",
            measured={"volume_fraction": spec.volume_fraction},
        )
    half: float = brentq(lambda h: wall_share(surface, h) - spec.volume_fraction, 0.0, surface.band, xtol=1e-6)
    envelope = Solid.of(TriangleMesh(domain.vertices, domain.faces))
    left = sum((side & envelope).volume for side in channels(surface, 2 * half))
    return 2 * half * spec.volume_fraction / (1 - left / envelope.volume)


def wall_share(surface: Surface, half: float) -> float:
    """Share of the domain within ``half`` (unit-cube units) of the surface; cut voxels count by their part."""
    spacing = surface.grid.spacing
    voxels = surface.depth > -spacing
    inside = np.clip(surface.depth[voxels] / spacing + 0.5, 0, 1)
    # Where both sides of a thin wall lie in one voxel, the voxel holds at most the wall's own thickness.
    walled = np.clip((half - np.abs(surface.distance[voxels])) / spacing + 0.5, 0, min(1.0, 2 * half / spacing))
    return float((inside * walled).sum() / inside.sum())


def channels(surface: Surface, thickness: float) -> tuple[Solid, Solid]:
    """The two sides of the wall, not yet cut to the domain: hot and cold.

    Parameters
    ----------
    surface
        Distance to the separating surface, exact beyond half the thickness by two voxels.
    thickness
        Unit-cube units.
    """
    sides = []
    for name, sign in (("hot", 1), ("cold", -1)):
        side = level_set(sign * surface.distance, surface.grid, thickness / 2)
        if len(side.faces) == 0:
            raise WallTooThick(
                f"A wall of {thickness:.3g} of the domain's longest side leaves no room for the {name} fluid.",
                advice="Make the wall thinner or use fewer sites.",
                measured={"wall_over_longest_side": thickness},
            )
        sides.append(Solid.of(_at_distance(side, surface, thickness / 2)))
    return sides[0], sides[1]


def _at_distance(side: TriangleMesh, surface: Surface, half: float) -> TriangleMesh:
    """The mesh with its vertices moved to lie at exactly ``half`` from the surface.

    Marching cubes takes the distance as linear between voxels; where the surface bends inside a thin wall it is not.
    Only small corrections are made: the caps at the grid's end lie further away and stay.
    """
    squared, _, foot = igl.point_mesh_squared_distance(side.vertices, surface.sheet.vertices, surface.sheet.faces)
    distance = np.sqrt(squared)
    near = (np.abs(distance - half) < 0.25 * surface.grid.spacing) & (distance > 0.1 * half)
    factor = np.where(near, half / np.where(near, distance, 1.0), 1.0)[:, None]
    return TriangleMesh(np.where(near[:, None], foot + factor * (side.vertices - foot), side.vertices), side.faces)
