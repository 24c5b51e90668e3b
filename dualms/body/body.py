"""The product: a printable solid and two fluid volumes with named patches, exact at the envelope."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dualms.beside import Here, Passed
from dualms.body.budget import simplified
from dualms.body.header import LIFT_VOXELS, Header
from dualms.body.openings import core
from dualms.body.outline import Outline, outline_of
from dualms.body.patches import INTERFACE, patch_names, patch_of_faces
from dualms.body.thickness import Wall, least, thickness_at
from dualms.body.walls import channel
from dualms.body.written import as_written
from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import ChannelBlocked, InvalidBody
from dualms.spec.body import MAX_FACES
from dualms.surface import Sheet, level_set
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
    crossing
        Triangles that cross others in single precision: 0 is right.
    """

    mesh: TriangleMesh
    patch: NDArray[np.int64]
    patches: tuple[str, ...]
    components: int
    filled_m3: float
    crossing: int


@dataclass(frozen=True)
class Body:
    """Solid and fluids, in metres.

    Parameters
    ----------
    solid
        Wall, shell and headers: the body's outline less both fluids, closed.
    solid_side
        (F,) int64 for each face of the solid: 1 towards the hot fluid, -1 towards the cold, 0 outside.
    hot, cold
        The fluid volumes.
    wall_m, shell_m
        Asked thickness of the separating wall (its mean over the interface, where it is graded), and of the shell (0
        without).
    outline_m3
        What solid and fluids fill together: the envelope, with the shell if it stands outside, and the headers.
    dropped_m3
        Slivers of solid that hang on nothing and were left out.
    leak_m3
        Common volume of the two fluids: 0 is right.
    crossing
        Triangles of the solid that cross others in single precision: 0 is right.
    """

    solid: TriangleMesh
    solid_side: NDArray[np.int64]
    hot: Fluid
    cold: Fluid
    wall_m: float
    shell_m: float
    outline_m3: float
    dropped_m3: float
    leak_m3: float
    crossing: int


@dataclass(frozen=True)
class Room(Passed):
    """Where a fluid is, reaching beyond the body's outline at its openings; unit-cube frame.

    Parameters
    ----------
    mesh
        Its closed boundary.
    facing
        (F,) what its faces are towards: 0 the other fluid, 1 the shell.
    """

    mesh: TriangleMesh
    facing: NDArray[np.int64]

    @cached_property
    def solid(self) -> Solid:
        """As a body; its first origin is the interface."""
        return Solid.of_parts(self.mesh, self.facing)


@dataclass(frozen=True)
class Side:
    """What one fluid takes from a body, unit-cube frame.

    Parameters
    ----------
    room
        Where the fluid is.
    part, pockets
        What of it lies in the outline: the part that joins the fluid's ports, and what is left to the solid.
    fluid
        The part, as files will hold it.
    """

    room: Room
    part: TriangleMesh
    pockets: tuple[TriangleMesh, ...]
    fluid: Fluid


@dataclass(frozen=True)
class Recipe(Passed):
    """What a body is made from: its sides can be made in different processes, and joined in one.

    Parameters
    ----------
    domain
        The envelope and its ports.
    sheet
        The separating surface, with distances to it and, as far as the shell, to the envelope.
    wall, shell
        Thicknesses, unit-cube units; a shell of 0 is none.
    outside
        Whether the shell stands outside the envelope.
    headers
        Stub pipes on ports.
    unit_m
        Metres of the unit that files will be in: coordinates in it are exact in single precision.
    max_faces
        Triangles that the solid should have at most. It has more where the wall's thickness needs them.
    """

    domain: Domain
    sheet: Sheet
    wall: Wall
    shell: float
    outside: bool = False
    headers: tuple[Header, ...] = ()
    unit_m: float = 1.0
    max_faces: int = MAX_FACES

    @cached_property
    def outline(self) -> Outline:
        """What bounds the body from outside.

        Raises
        ------
        InvalidSpec
            If a header touches what it must not.
        """
        envelope = Solid.of(self.domain.boundary)
        return outline_of(self.domain, self.sheet, envelope, self.shell if self.outside else 0.0, self.headers)

    def side(self, sign: int) -> Side:
        """What the hot (1) or the cold (-1) fluid takes.

        Raises
        ------
        ChannelBlocked
            If the fluid's largest part does not join all of its ports.
        WallTooThick
            If nothing is left of it.
        """
        reach = (self.shell if self.outside else 0.0) + 2 * self.sheet.grid.spacing
        wall = simplified(channel(self.sheet, self.wall, reach, sign), least(self.wall) / 2, self.max_faces // 2)
        made = _room(self.domain, self.sheet, wall, self.shell, sign, self.outside, self.outline)
        mesh, origin = made.faces_by_origin()
        room = Room(mesh, (origin != wall.origin).astype(np.int64))
        part, pockets, fluid = _fluid(self.domain, room.solid, self.outline, sign, self.shell, self.unit_m)
        return Side(room, part.mesh(), tuple(pocket.mesh() for pocket in pockets), fluid)

    def join(self, hot: Side, cold: Side, beside: Executor) -> Body:
        """Cut both sides out of the outline; the volume that they have in common is measured beside.

        Raises
        ------
        InvalidBody
            If no solid is left, or it falls apart.
        """
        leak = beside.submit(_common, hot.part, cold.part)
        domain, outline = self.domain, self.outline.solid
        hot_room, cold_room = hot.room.solid, cold.room.solid
        # Subtract what reaches beyond the outline, not what was cut by it: no two faces coincide.
        block = outline - hot_room - cold_room
        for pocket in (*hot.pockets, *cold.pockets):
            block = block | Solid.of(pocket)
        parts = block.bodies()
        if not parts:
            raise InvalidBody("No solid is left.", advice="Make the wall or the shell thicker.")
        dropped = sum(part.volume for part in parts[1:])
        if dropped > NEGLIGIBLE * domain.volume:
            raise InvalidBody(
                f"The solid falls into {len(parts)} parts; {100 * dropped / domain.volume:.2g} % of the domain is not "
                "joined to the largest.",
                advice="Give the body a shell, or make the wall thicker.",
                measured={"parts": len(parts), "loose_fraction": dropped / domain.volume},
            )
        cubic = domain.scale_m**3
        solid, origin, crossing = _written(domain, parts[0], self.unit_m)
        return Body(
            solid=solid,
            solid_side=_of(hot_room, origin).astype(np.int64) - _of(cold_room, origin),
            hot=hot.fluid,
            cold=cold.fluid,
            wall_m=_mean_wall(domain, self.wall, hot.fluid),
            shell_m=self.shell * domain.scale_m,
            outline_m3=outline.volume * cubic,
            dropped_m3=dropped * cubic,
            leak_m3=leak.result() * cubic,
            crossing=crossing,
        )


def make_body(
    domain: Domain,
    sheet: Sheet,
    wall: Wall,
    shell: float,
    outside: bool = False,
    headers: tuple[Header, ...] = (),
    unit_m: float = 1.0,
    max_faces: int = MAX_FACES,
) -> Body:
    """Cut the two sides of the wall out of the envelope, in this process; see :class:`Recipe`."""
    recipe = Recipe(domain, sheet, wall, shell, outside, headers, unit_m, max_faces)
    return recipe.join(recipe.side(1), recipe.side(-1), Here())


def _of(room: Solid, origin: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which faces (F,) come from either part of a room."""
    return np.asarray((origin == room.origin) | (origin == room.origin + 1))


def _common(one: TriangleMesh, two: TriangleMesh) -> float:
    """Volume that two closed bodies have in common."""
    return (Solid.of(one) & Solid.of(two)).volume


def _room(
    domain: Domain,
    sheet: Sheet,
    side: Solid,
    shell: float,
    sign: int,
    outside: bool,
    outline: Outline,
) -> Solid:
    """Where a fluid is, reaching beyond the body's outline at its openings."""
    if not shell:
        return side
    own = {k: bore for k, bore in outline.bores.items() if domain.ports[k].fluid == sign}
    free = core(domain, sheet, shell, sign, outside, frozenset(own))
    if not own:
        return side & free
    # Up to just above the skin the fluid keeps to its side of the wall; above, the bores are wholly its own.
    lift = (shell if outside else 0.0) + LIFT_VOXELS * sheet.grid.spacing
    below = Solid.of(level_set(sheet.depth + np.float32(lift), sheet.grid))
    for bore in own.values():
        free = free | bore
    return free - (below - side)


def _mean_wall(domain: Domain, wall: Wall, fluid: Fluid) -> float:
    """Asked thickness over a fluid's interface, metres."""
    interface = fluid.mesh.part(fluid.patch == INTERFACE)
    asked = thickness_at(wall, (interface.centroids - domain.offset_m) / domain.scale_m)
    return float(np.average(asked, weights=interface.areas)) * domain.scale_m


def _fluid(
    domain: Domain, room: Solid, outline: Outline, sign: int, shell: float, unit_m: float
) -> tuple[Solid, list[Solid], Fluid]:
    """The part of a fluid that joins its ports, the pockets to fill in, and the part as files will hold it.

    The first origin of ``room`` is the interface.
    """
    name = "hot" if sign == 1 else "cold"
    indices = [k for k, port in enumerate(domain.ports) if port.fluid == sign]
    ports = [domain.ports[k] for k in indices]
    pipes = {outline.pipes[k].origin: at for at, k in enumerate(indices) if k in outline.pipes}
    cut = room & outline.solid
    parts = cut.bodies()
    best: tuple[set[int], Solid] | None = None
    for part in parts[:8]:  # by falling volume
        patch = patch_of_faces(*part.faces_by_origin(), room.origin, outline.skin, pipes, ports, shell)
        reached = set((np.unique(patch[patch >= 2]) - 2).tolist())
        if best is None or len(reached) > len(best[0]):
            best = (reached, part)
        if len(reached) == len(ports):
            break
    if best is None or len(best[0]) < len(ports):
        reached, total = (set() if best is None else best[0]), len(ports)
        missed = [port.name for k, port in enumerate(ports) if k not in reached]
        raise ChannelBlocked(
            f"No part of the {name} fluid joins all of its {total} ports; the best of {len(parts)} parts reaches "
            f"{len(reached)}, not {', '.join(missed)}.",
            advice="Make the wall or shell thinner, the ports larger, or use fewer sites.",
            measured={
                "fluid": name,
                "parts": len(parts),
                "ports_reached": len(reached),
                "ports": total,
                "missed": missed,
            },
        )
    part = best[1]
    mesh, origin, crossing = _written(domain, part, unit_m)
    in_unit_cube = mesh.moved(1 / domain.scale_m, -domain.offset_m / domain.scale_m)
    filled = cut.volume - part.volume
    fluid = Fluid(
        mesh=mesh,
        patch=patch_of_faces(in_unit_cube, origin, room.origin, outline.skin, pipes, ports, shell),
        patches=patch_names(ports),
        components=int((mesh.shell_volumes() > 0).sum()),
        filled_m3=filled * domain.scale_m**3,
        crossing=crossing,
    )
    return part, [pocket for pocket in parts if pocket is not part], fluid


def _written(domain: Domain, solid: Solid, unit_m: float) -> tuple[TriangleMesh, NDArray[np.int64], int]:
    """A boundary in metres, exact in single precision in the files' unit, origins of its faces, crossing ones."""
    mesh, origin, crossing = as_written(solid, domain.scale_m / unit_m, domain.offset_m / unit_m)
    return mesh.moved(unit_m, np.zeros(3)), origin, crossing


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
