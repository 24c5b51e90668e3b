"""The separating wall: all points nearer to the surface than half its thickness, by true distance (paper, sec. 3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dualms.body.offset import offset_surface
from dualms.body.thickness import GradedWall, Wall, least, thickness_at
from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import WallTooThick
from dualms.grid import Grid
from dualms.spec import Unit, WallGraded, WallSpec, WallThickness
from dualms.surface import Sheet, extract_sheet, level_set

Array = NDArray[np.float64]
Values = NDArray[np.float32]

FLAT = 0.06  # of half the thickness: triangles of marching cubes that lie so near to a common plane are merged
SAG = 0.025  # of half the thickness: how far the middle of an edge may lie off then
BAND_VOXELS = 1.1  # of exact distance beyond half the wall: an edge that crosses its surface ends within one
THICKEST = 0.12  # unit-cube units; thicker is not tried for a wall given by its share
SHARE_RESOLUTION = 48  # and its double: a share's two grids


def graded_wall(spec: WallSpec, units: Unit, domain: Domain) -> GradedWall | None:
    """The wall that a specification grades; None where it is even."""
    return GradedWall.of(spec, units, domain) if isinstance(spec, WallGraded) else None


def wall_thickness(spec: WallSpec, units: Unit, domain: Domain, field: Callable[[Grid], Values]) -> Wall:
    """Thickness of the wall in unit-cube units.

    Parameters
    ----------
    spec
        The thickness, in ``units``, constant or graded, or the share of the domain's volume that the wall takes.
    units
        Unit of the specification.
    domain
        The envelope.
    field
        Samples of the field on a grid.

    Returns
    -------
    Wall
        The thickness, or a graded wall. A share is met on the voxels of two grids; the thickness's error falls with the
        square of their spacing, and is extrapolated to none.

    Raises
    ------
    WallTooThick
        If the share asks for more than 0.12 of the domain's longest side.
    """
    if isinstance(spec, WallThickness):
        return spec.thickness * units.metres / domain.scale_m
    if isinstance(spec, WallGraded):
        return GradedWall.of(spec, units, domain)
    coarse = _half_of_share(spec.volume_fraction, domain, SHARE_RESOLUTION, THICKEST / 2, field)
    if coarse is None:
        raise WallTooThick(
            f"A wall of {100 * spec.volume_fraction:.3g} % of the domain would be thicker than "
            f"{THICKEST * domain.scale_m / units.metres:.3g} {units.value}.",
            advice="Ask for a smaller volume_fraction or more sites.",
            measured={"volume_fraction": spec.volume_fraction},
        )
    fine = _half_of_share(spec.volume_fraction, domain, 2 * SHARE_RESOLUTION, 1.2 * coarse, field) or coarse
    return 2 * (fine + (fine - coarse) / 3)


def _half_of_share(
    share: float, domain: Domain, resolution: int, most: float, field: Callable[[Grid], Values]
) -> float | None:
    """Half the thickness of a wall that takes a share of the domain on a grid; None if that is more than ``most``."""
    grid = domain.grid(resolution, padding=4)
    sheet = extract_sheet(domain, field(grid), grid, most + BAND_VOXELS * grid.spacing)
    if wall_share(sheet, most) < share:
        return None
    return float(brentq(lambda half: wall_share(sheet, half) - share, 0.0, most, xtol=1e-6))


def wall_share(sheet: Sheet, half: float | Values) -> float:
    """Share of the domain within ``half`` (unit-cube units) of the surface; cut voxels count by their part.

    ``half`` may hold a value for every voxel of the sheet's grid.
    """
    spacing = sheet.grid.spacing
    voxels = sheet.depth > -spacing
    inside = np.clip(sheet.depth[voxels] / spacing + 0.5, 0, 1)
    reach = np.broadcast_to(half, voxels.shape)[voxels]
    # Where both sides of a thin wall lie in one voxel, the voxel holds at most the wall's own thickness.
    walled = np.clip((reach - np.abs(sheet.distance[voxels])) / spacing + 0.5, 0, np.minimum(1.0, 2 * reach / spacing))
    return float((inside * walled).sum() / inside.sum())


def channel(sheet: Sheet, wall: Wall, reach: float, sign: int) -> Solid:
    """One side of the wall, not yet cut to the domain.

    Parameters
    ----------
    sheet
        Distance to the separating surface, exact beyond half the greatest thickness by two voxels.
    wall
        Thickness, unit-cube units.
    reach
        How far outside the envelope the side is wanted exact.
    sign
        1 hot, -1 cold.

    Raises
    ------
    WallTooThick
        If the wall leaves no room for the fluid.
    """
    half = half_on_grid(sheet, wall)
    # Beyond the reach it ends: what is cut off later need not be made.
    near = sheet.depth + np.float32(reach + sheet.grid.spacing)
    beyond = sign * sheet.distance - np.float32(half)
    side = level_set(np.where(near > 0, beyond, np.minimum(beyond, near)), sheet.grid)
    if len(side.faces) == 0:
        name = "hot" if sign == 1 else "cold"
        raise WallTooThick(
            f"A wall of {2 * np.max(half):.3g} of the domain's longest side leaves no room for the {name} fluid.",
            advice="Make the wall thinner or use fewer sites.",
            measured={"wall_over_longest_side": float(2 * np.max(half))},
        )
    level = Solid.of(side).simplified(FLAT * least(wall) / 2).mesh()
    return Solid.of(offset_surface(level, sheet, lambda p: thickness_at(wall, p) / 2, SAG, reach))


def half_on_grid(sheet: Sheet, wall: Wall) -> float | Values:
    """Half the thickness: one value, or one for every voxel of the sheet's grid."""
    if isinstance(wall, GradedWall):
        values = (wall.at(sheet.grid.points()) / 2).astype(np.float32)
        return np.asarray(values.reshape(sheet.grid.shape))
    return wall / 2
