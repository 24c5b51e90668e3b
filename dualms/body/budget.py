"""Fewer triangles: what the wall's thickness does not need is merged, and more of it where a budget of faces asks.

Merging (manifold3d's ``simplify``) happens before the booleans, which keeps every mesh closed by construction.
"""

from __future__ import annotations

from dualms.booleans import Solid

TOLERANCES = (0.04, 0.05)
"""How far a side's faces may move, over half the wall's thickness: the first at any rate, the others for a budget.

Beyond the last the thickness would leave 3 % of the asked (decision note 0012).
"""


def simplified(sides: tuple[Solid, Solid], half: float, faces: int) -> tuple[Solid, Solid]:
    """The two sides of the wall with fewer triangles.

    Parameters
    ----------
    sides
        Not yet cut to the domain.
    half
        Half of the least thickness of the wall, unit-cube units.
    faces
        How many triangles the solid may have. Those of both sides, which reach a little beyond the envelope, stand for
        its.

    Returns
    -------
    tuple
        Simplified as little as the budget allows; where it cannot be kept, as far as the wall's thickness allows.
    """
    for share in TOLERANCES:
        one, two = (side.simplified(share * half) for side in sides)
        if one.faces + two.faces <= faces:
            break
    return one, two
