"""The product: a printable solid and two fluid volumes with named patches, exact at the envelope."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dualms.body.openings import core
from dualms.body.patches import patch_names, patch_of_faces
from dualms.body.walls import channels
from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import ChannelBlocked, InvalidBody
from dualms.surface import Surface, to_metres
from dualms.triangles import TriangleMesh

NEGLIGIBLE = 1e-3  # of the domain's volume: what may be filled in or dropped without being an error


@dataclass(frozen=True)
class Fluid:
    """One fluid's volume.

    Parameters
    ----------
    mesh
        Closed boundary, metres.
    patch
        (F,) int64 index into ``patches``.
    patches
        Names: ``interface``, ``wall`` and one a port.
    components
        Connected parts; 1 is right.
    filled_m3
        Volume of pockets that no port reached: they were left to the solid, so no powder is trapped in them.
    """

    mesh: TriangleMesh
    patch: NDArray[np.int64]
    patches: tuple[str, ...]
    components: int
    filled_m3: float


@dataclass(frozen=True)
class Body:
    """Solid and fluids, in metres.

    Parameters
    ----------
    solid
        Wall and shell: the envelope less both fluids, closed.
    solid_side
        (F,) int64 for each face of the solid: 1 towards the hot fluid, -1 towards the cold, 0 outside.
    hot, cold
        The fluid volumes.
    wall_m, shell_m
        Asked thickness of the separating wall, and of the shell (0 without).
    dropped_m3
        Slivers of solid that hang on nothing and were left out.
    leak_m3
        Common volume of the two fluids: 0 is right.
    """

    solid: TriangleMesh
    solid_side: NDArray[np.int64]
    hot: Fluid
    cold: Fluid
    wall_m: float
    shell_m: float
    dropped_m3: float
    leak_m3: float


def make_body(domain: Domain, surface: Surface, wall: float, shell: float) -> Body:
    """Cut the two sides of the wall out of the envelope.

    Parameters
    ----------
    domain
        The envelope and its ports.
    surface
        The separating surface, with distances to it and, down to the shell, to the envelope.
    wall, shell
        Thicknesses, unit-cube units; a shell of 0 is none.

    Raises
    ------
    ChannelBlocked
        If a fluid's largest part does not join all of its ports.
    WallTooThick, InvalidBody
        If nothing is left, or a boolean fails.
    """
    envelope = Solid.of(TriangleMesh(domain.vertices, domain.faces))
    made: dict[int, tuple[Solid, Fluid]] = {}
    side_of: dict[int, int] = {}
    block = envelope
    for sign, side in zip((1, -1), channels(surface, wall), strict=True):
        room = side
        if shell:
            free = core(domain, surface, shell, sign)
            side_of[free.origin] = sign
            room = side & free
        side_of[side.origin] = sign
        part, pockets, fluid = _fluid(domain, room & envelope, side.origin, envelope.origin, sign, shell)
        made[sign] = part, fluid
        # Subtract what reaches beyond the envelope, not what was cut by it: no two faces coincide.
        block = block - room
        for pocket in pockets:
            block = block | pocket
    (hot_solid, hot), (cold_solid, cold) = made[1], made[-1]
    parts = block.bodies()
    if not parts:
        raise InvalidBody("No solid is left.", advice="Make the wall or the shell thicker.")
    dropped = sum(part.volume for part in parts[1:])
    if dropped > NEGLIGIBLE * envelope.volume:
        raise InvalidBody(
            f"The solid falls into {len(parts)} parts; {100 * dropped / envelope.volume:.2g} % of the domain is not "
            "joined to the largest.",
            advice="Give the body a shell, or make the wall thicker.",
            measured={"parts": len(parts), "loose_fraction": dropped / envelope.volume},
        )
    cubic = domain.scale_m**3
    solid, origin = parts[0].faces_by_origin()
    return Body(
        solid=to_metres(domain, solid),
        solid_side=np.array([side_of.get(o, 0) for o in range(origin.max() + 1)])[origin],
        hot=hot,
        cold=cold,
        wall_m=wall * domain.scale_m,
        shell_m=shell * domain.scale_m,
        dropped_m3=dropped * cubic,
        leak_m3=(hot_solid & cold_solid).volume * cubic,
    )


def _fluid(
    domain: Domain, cut: Solid, interface: int, envelope: int, sign: int, shell: float
) -> tuple[Solid, list[Solid], Fluid]:
    """The part of a fluid that joins its ports, the pockets to fill in, and the part's mesh with its patches."""
    name = "hot" if sign == 1 else "cold"
    ports = [port for port in domain.ports if port.fluid == sign]
    parts = cut.bodies()
    best: tuple[int, Solid, TriangleMesh, NDArray[np.int64]] | None = None
    for part in parts[:8]:  # by falling volume
        mesh, origin = part.faces_by_origin()
        patch = patch_of_faces(mesh, origin, interface, envelope, ports, shell)
        reached = len(np.unique(patch[patch >= 2]))
        if best is None or reached > best[0]:
            best = (reached, part, mesh, patch)
        if reached == len(ports):
            break
    if best is None or best[0] < len(ports):
        reached, total = (0 if best is None else best[0]), len(ports)
        raise ChannelBlocked(
            f"No part of the {name} fluid joins all of its {total} ports; the best of {len(parts)} parts reaches "
            f"{reached}.",
            advice="Make the wall or shell thinner, the ports larger, or use fewer sites.",
            measured={"fluid": name, "parts": len(parts), "ports_reached": reached, "ports": total},
        )
    _, part, mesh, patch = best
    filled = cut.volume - part.volume
    fluid = Fluid(
        mesh=to_metres(domain, mesh),
        patch=patch,
        patches=patch_names(ports),
        components=len(part.bodies()),
        filled_m3=filled * domain.scale_m**3,
    )
    return part, [pocket for pocket in parts if pocket is not part], fluid


def filled_fraction(fluid: Fluid) -> float:
    """Share of a fluid's room that was left to the solid."""
    total = fluid.mesh.volume + fluid.filled_m3
    return fluid.filled_m3 / total if total else 0.0


def in_units(body: Body, metres: float) -> Body:
    """The body with lengths in a unit of so many metres, for writing files in the domain's own units."""
    zero = np.zeros(3)
    k = 1 / metres
    return replace(
        body,
        solid=body.solid.moved(k, zero),
        hot=replace(body.hot, mesh=body.hot.mesh.moved(k, zero)),
        cold=replace(body.cold, mesh=body.cold.mesh.moved(k, zero)),
    )
