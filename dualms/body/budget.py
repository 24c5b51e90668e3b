"""Fewer triangles: what the wall's thickness does not need is merged, and more of it where a budget of faces asks.

Merging (manifold3d's ``simplify``) happens before the booleans, which keeps every mesh closed by construction.
"""

from __future__ import annotations

from dualms.booleans import Solid

TOLERANCES = (0.04, 0.05)
"""How far a side's faces may move, over half the wall's thickness: the first at any rate, the others for a budget.

Beyond the last the thickness would leave 3 % of the asked (decision note 0012).
"""


def simplified(side: Solid, half: float, faces: int) -> Solid:
    """A side of the wall with fewer triangles.

    Parameters
    ----------
    side
        Not yet cut to the domain.
    half
        Half of the least thickness of the wall, unit-cube units.
    faces
        How many triangles it may have. A side, which reaches a little beyond the envelope, stands for its half of the
        solid.

    Returns
    -------
    Solid
        Simplified as little as the budget allows; where it cannot be kept, as far as the wall's thickness allows.
    """
    for share in TOLERANCES:
        fewer = side.simplified(share * half)
        if fewer.faces <= faces:
            break
    return fewer
