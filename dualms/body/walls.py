"""The separating wall: all points nearer to the surface than half its thickness, by true distance (paper, section 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dualms.booleans import Solid
from dualms.errors import WallTooThick
from dualms.spec import Unit, WallFraction, WallThickness
from dualms.surface import Surface, level_set

Values = NDArray[np.float32]


def wall_thickness(
    spec: WallThickness | WallFraction, units: Unit, scale_m: float, surface: Surface, inside: NDArray[np.bool_]
) -> float:
    """Thickness of the wall in unit-cube units.

    Parameters
    ----------
    spec
        Either the thickness, in ``units``, or the share of the domain's volume that the wall takes.
    units, scale_m
        Unit of the specification, and metres per unit of the unit cube.
    surface
        Holds the distance to the separating surface.
    inside
        Which voxels of the surface's grid lie in the domain.

    Returns
    -------
    float
        The thickness. A share is turned into one by the distribution of the distance over the domain's voxels.

    Raises
    ------
    WallTooThick
        If the share cannot be reached within the band where distances are known.
    """
    if isinstance(spec, WallThickness):
        return spec.thickness * units.metres / scale_m
    half = float(np.quantile(np.abs(surface.distance[inside]), spec.volume_fraction))
    if half >= surface.band:
        raise WallTooThick(
            f"A wall of {100 * spec.volume_fraction:.3g} % of the domain would be thicker than "
            f"{2 * surface.band * scale_m / units.metres:.3g} {units.value}.",
            advice="Ask for a smaller volume_fraction or more sites.",
            measured={"volume_fraction": spec.volume_fraction},
        )
    return 2 * half


def channels(surface: Surface, thickness: float) -> tuple[Solid, Solid]:
    """The two sides of the wall, not yet cut to the domain: hot and cold.

    Parameters
    ----------
    surface
        Distance to the separating surface, exact beyond half the thickness by two voxels.
    thickness
        Unit-cube units.
    """
    hot = level_set(surface.distance, surface.grid, thickness / 2)
    cold = level_set(-surface.distance, surface.grid, thickness / 2)
    for name, side in (("hot", hot), ("cold", cold)):
        if len(side.faces) == 0:
            raise WallTooThick(
                f"A wall of {thickness:.3g} of the domain's longest side leaves no room for the {name} fluid.",
                advice="Make the wall thinner or use fewer sites.",
                measured={"wall_over_longest_side": thickness},
            )
    return Solid.of(hot), Solid.of(cold)
