"""What bounds a body from outside: the envelope, a shell that stands on it, and the pipes of headers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualms.body.header import Header
from dualms.body.headers import refuse_collisions
from dualms.body.offset import at_distance
from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.nearest import Nearest
from dualms.surface import Sheet, level_set


@dataclass(frozen=True)
class Outline:
    """What bounds the body from outside, and by which bodies its faces were made.

    Parameters
    ----------
    solid
        The envelope, with a shell outside it, and the pipes of the headers.
    skin
        Origin of what is not a pipe.
    pipes, bores
        Of each header; a pipe's origin marks the end where the fluid comes out.
    """

    solid: Solid
    skin: int
    pipes: dict[int, Solid]
    bores: dict[int, Solid]


def outline_of(domain: Domain, sheet: Sheet, envelope: Solid, skin: float, headers: tuple[Header, ...]) -> Outline:
    """The envelope with a skin of a thickness (unit-cube units) outside it, and the pipes of the headers.

    Raises
    ------
    InvalidSpec
        If a header touches what it must not.
    """
    body = envelope
    if skin:
        grown = level_set(sheet.depth + np.float32(skin), sheet.grid)
        body = Solid.of(
            at_distance(grown, Nearest(envelope.mesh()), lambda points: np.full(len(points), skin), sheet.grid.spacing)
        )
    refuse_collisions(domain, headers, body, sheet.grid, skin)
    pipes = {h.port: h.pipe(sheet.grid, skin) for h in headers}
    bores = {h.port: h.bore(sheet.grid, skin) for h in headers}
    solid = body
    for pipe in pipes.values():
        solid = solid | pipe
    return Outline(solid, body.origin, pipes, bores)
