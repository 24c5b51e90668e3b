"""Headers: stub pipes that carry a port out of the envelope, tapering from the port's outline to a round end.

A pipe is a loft of rings about the port's axis. Its bore starts just above the body's skin, where the opening through
the shell ends, so nothing that belongs to the other fluid is ever cut. A taper stands at 45° or steeper: it needs no
support when printed upright, and the flow follows it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import InvalidSpec
from dualms.grid import Grid
from dualms.ports import SAMPLES_ACROSS, Port
from dualms.spec import FluidsSpec, HeaderSpec, ShellSpec, Unit
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

SIDES = 128  # of a ring; its circles have the area of the round pipe
LIFT_VOXELS = 1.0  # the bore starts so far above the skin, clear of its sharp edges as voxels see them
STRAIGHT_VOXELS = 3.0  # the port's outline is kept so far above the skin, then the taper begins
UNCOVERED = 0.03  # share of the outline that may miss the port: it is sampled, and disks are sampled at their rim


@dataclass(frozen=True)
class Header:
    """A stub pipe on a port, unit-cube frame.

    Parameters
    ----------
    port
        Index in the domain's ports.
    center, axis
        (3,) point on the port that lengths are measured from, and unit direction outward.
    across
        (2, 3) unit vectors that span the plane of the rings.
    sides
        (E, 2) unit normals of the port's convex outline in that plane, and
    reach
        (E,) how far each side lies from the centre; a disk has as many sides as its ring.
    low, high
        The port's lowest and highest point along the axis, over the centre.
    radius, length, wall
        Of the pipe; the length counts from the skin.
    flange
        Radius and thickness of the plate at its end; zero for none.
    """

    port: int
    center: Array
    axis: Array
    across: Array
    sides: Array
    reach: Array
    low: float
    high: float
    radius: float
    length: float
    wall: float
    flange: tuple[float, float]

    def bore(self, grid: Grid, skin: float) -> Solid:
        """What the fluid takes, from below the skin to beyond the pipe's end.

        Parameters
        ----------
        grid
            Its spacing sets how far the outline is kept.
        skin
            Thickness of the shell outside the envelope, 0 for one inside.
        """
        turn, end = self._turn(grid, skin), skin + self.length
        below = self.low - 2 * grid.spacing
        return self._loft(below, turn, turn + self._taper(), end + self.wall, 0.0)

    def pipe(self, grid: Grid, skin: float) -> Solid:
        """The pipe with its bore filled, and the flange."""
        turn, end = self._turn(grid, skin), skin + self.length
        below = self.low - max(2 * self.wall, 3 * grid.spacing)
        body = self._loft(below, turn, turn + self._taper(), end, self.wall)
        radius, thickness = self.flange
        if thickness:
            ring = _circle(radius)
            plate = _loft([self._placed(ring, np.full(SIDES, h)) for h in (end - thickness, end)])
            body = Solid.of((body | Solid.of(plate)).mesh())
        return body

    def above(self, grid: Grid, skin: float) -> Solid:
        """The part of the pipe that must be clear of the body."""
        turn, end = self._turn(grid, skin), skin + self.length
        return self._loft(None, turn, turn + self._taper(), end, self.wall)

    def needed(self, grid: Grid, skin: float) -> float:
        """Least length that holds outline, taper and flange."""
        return self._turn(grid, skin) - skin + self._taper() + self.flange[1]

    def end(self, port: Port, skin: float) -> Port:
        """The port at the pipe's end, where the fluid now enters or leaves."""
        step = 1.0 / SAMPLES_ACROSS
        line = np.arange(-np.ceil(self.radius / step), np.ceil(self.radius / step) + 1) * step
        u, v = (a.ravel() for a in np.meshgrid(line, line))
        disk = u**2 + v**2 <= self.radius**2
        center = self.center + (skin + self.length) * self.axis
        return replace(
            port,
            samples=center + np.stack([u[disk], v[disk]], axis=1) @ self.across,
            center=center,
            normal=self.axis,
            area=np.pi * self.radius**2,
            shape="disk",
            extent=np.stack([center, np.array([self.radius, 0.0, 0.0])]),
        )

    def holds(self, points: Array, grid: Grid, skin: float) -> NDArray[np.bool_]:
        """(P,) which points (P, 3) lie in the bore, up to the pipe's end."""
        offset = points - self.center
        height, flat = offset @ self.axis, offset @ self.across.T
        radius = np.linalg.norm(flat, axis=1)
        # Over the outline this is 1 on its sides: the distance from the axis in units of theirs.
        share = (flat @ self.sides.T / self.reach).max(axis=1)
        outline = radius / np.maximum(share, 1e-12)
        taper = self._taper()
        narrowed = np.clip((height - self._turn(grid, skin)) / taper, 0, 1) if taper > 1e-9 else 1.0
        limit = (1 - narrowed) * outline + narrowed * self.radius
        return np.asarray(
            (radius < limit) & (height > self.low - 2 * grid.spacing) & (height < skin + self.length), dtype=bool
        )

    def _turn(self, grid: Grid, skin: float) -> float:
        return self.high + skin + STRAIGHT_VOXELS * grid.spacing

    def _taper(self) -> float:
        return float(np.abs(self._outline(0.0) - _circle(self.radius)).max())

    def _loft(self, below: float | None, turn: float, narrow: float, end: float, wall: float) -> Solid:
        """Rings from the outline to the circle, grown by ``wall`` measured across the pipe's own surface."""
        outline, circle = self._outline(wall), _circle(self.radius + wall)
        # Half the angle of the taper, side by side: where the grown surface turns.
        slope = np.arctan2(self._outline(0.0) - _circle(self.radius), max(narrow - turn, 1e-12))
        shift = wall * np.tan(slope / 2)
        rings = [] if below is None else [self._placed(outline, np.full(SIDES, below))]
        rings.append(self._placed(outline, turn + shift))
        if self._taper() > 1e-9:
            rings.append(self._placed(circle, narrow + shift))
        rings.append(self._placed(circle, np.full(SIDES, end)))
        return Solid.of(_loft(rings))

    def _outline(self, grow: float) -> Array:
        """(SIDES,) distance of the outline from the axis, its sides moved outward by ``grow``."""
        facing = self.sides @ _directions().T
        along = np.where(facing > 1e-6, (self.reach[:, None] + grow) / np.maximum(facing, 1e-6), np.inf)
        return np.asarray(along.min(axis=0))

    def _placed(self, radii: Array, heights: Array) -> Array:
        flat = (radii[:, None] * _directions()) @ self.across
        return np.asarray(self.center + flat + heights[:, None] * self.axis)


def headers_of(domain: Domain, fluids: FluidsSpec, units: Unit, shell: ShellSpec | None) -> tuple[Header, ...]:
    """The headers that a specification asks for.

    Parameters
    ----------
    domain
        Its ports are those of ``fluids``, in their order.
    fluids, units
        The specification's ports and the unit of its lengths.
    shell
        Gives the wall of a pipe that has none of its own.

    Raises
    ------
    InvalidSpec
        If a port's outline is not convex or runs over an edge, or a flange does not reach beyond its pipe.
    """
    asked = [port.header for f in (fluids.hot, fluids.cold) for ports in (f.inlets, f.outlets) for port in ports]
    k = units.metres / domain.scale_m
    made = []
    for index, (port, header) in enumerate(zip(domain.ports, asked, strict=True)):
        if header is None:
            continue
        if shell is None:
            raise InvalidSpec(f"The header of {port.name} needs a shell to stand on.", advice="Give the body a shell.")
        wall = k * (shell.thickness if header.wall is None else header.wall)
        flange = (k * header.flange.radius, k * header.flange.thickness) if header.flange else (0.0, 0.0)
        if header.flange and flange[0] <= k * header.radius + wall:
            raise InvalidSpec(
                f"The flange of {port.name} has a radius of {header.flange.radius:g}, but its pipe reaches "
                f"{header.radius + wall / k:g} {units.value}.",
                advice="Widen the flange or leave it out.",
                measured={"port": port.name},
            )
        made.append(_on_port(domain, index, header, k, wall, flange))
    return tuple(made)


def at_pipe_ends(domain: Domain, headers: tuple[Header, ...], skin: float) -> Domain:
    """The domain with its ports moved to the ends of their pipes."""
    ports = list(domain.ports)
    for header in headers:
        ports[header.port] = header.end(ports[header.port], skin)
    return replace(domain, ports=tuple(ports))


def bounds(domain: Domain, headers: tuple[Header, ...], skin: float) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of the domain with its headers' bores."""
    ends = [at_pipe_ends(domain, headers, skin).ports[h.port].samples for h in headers]
    points = np.concatenate([domain.vertices, *ends])
    return points.min(axis=0), points.max(axis=0)


def refuse_collisions(domain: Domain, headers: tuple[Header, ...], body: Solid, grid: Grid, skin: float) -> None:
    """Refuse headers that are too short for their taper, or touch the body, another port or another pipe's bore.

    Parameters
    ----------
    body
        The envelope with its outer shell.
    grid, skin
        As for :meth:`Header.bore`.

    Raises
    ------
    InvalidSpec
        With the port's name and the measured figure.
    """
    for header in headers:
        port = domain.ports[header.port]
        needed = header.needed(grid, skin)
        if header.length < needed:
            raise InvalidSpec(
                f"The header of {port.name} is {header.length * domain.scale_m:.4g} m long; its taper at 45° and its "
                f"flange need {needed * domain.scale_m:.4g} m.",
                advice="Lengthen it, or bring its radius nearer to the port's.",
                measured={"port": port.name, "needed_m": needed * domain.scale_m},
            )
        common = (header.above(grid, skin) & body).volume
        if common > 0:
            raise InvalidSpec(
                f"The header of {port.name} runs into the body: {common * domain.scale_m**3:.3g} m³ in common.",
                advice="Shorten it or move the port to a freer place.",
                measured={"port": port.name, "common_m3": common * domain.scale_m**3},
            )
        for other in domain.ports:
            if other is not port and _stands_on(header, other):
                raise InvalidSpec(
                    f"The header of {port.name} stands on port {other.name}.",
                    advice="Move the ports apart, or make the pipe's wall thinner.",
                    measured={"ports": [port.name, other.name]},
                )
    solids = [(h, h.bore(grid, skin), h.pipe(grid, skin)) for h in headers]
    for (one, bore, _), (two, _, pipe) in permutations(solids, 2):
        if not (bore & pipe).is_empty:
            names = [domain.ports[h.port].name for h in (one, two)]
            raise InvalidSpec(
                f"The headers of {names[0]} and {names[1]} run into each other.",
                advice="Shorten them, make their flanges smaller, or move the ports apart.",
                measured={"ports": names},
            )


def _on_port(
    domain: Domain, index: int, asked: HeaderSpec, k: float, wall: float, flange: tuple[float, float]
) -> Header:
    port = domain.ports[index]
    if port.shape == "box":
        normal = np.zeros(3)
        axis = int(np.abs(port.normal).argmax())
        normal[axis] = np.sign(port.normal[axis])
        across = np.delete(np.eye(3), axis, axis=0)
    else:
        normal = port.normal
        first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        first /= np.linalg.norm(first)
        across = np.stack([first, np.cross(normal, first)])
    flat = port.samples @ across.T
    if port.shape == "disk":
        middle = across @ port.extent[0]
        sides, reach = _directions(), _circle(port.extent[1, 0])
    elif port.shape == "box":
        low, high = flat.min(axis=0), flat.max(axis=0)
        middle = (low + high) / 2
        sides = np.concatenate([np.eye(2), -np.eye(2)])
        reach = np.tile((high - low) / 2, 2)
    else:
        corners = domain.vertices[np.unique(domain.faces[port.triangles])] @ across.T
        middle = across @ port.center
        hull = ConvexHull(corners).equations
        sides, reach = hull[:, :2], -hull[:, 2] - hull[:, :2] @ middle
    heights = port.samples @ normal
    level = heights[((flat - middle) ** 2).sum(axis=1).argmin()]
    center = middle @ across + level * normal
    header = Header(
        port=index,
        center=center,
        axis=normal,
        across=across,
        sides=sides,
        reach=reach,
        low=float(heights.min() - level),
        high=float(heights.max() - level),
        radius=k * asked.radius,
        length=k * asked.length,
        wall=wall,
        flange=flange,
    )
    bare = _uncovered(header, flat - middle)
    if bare > UNCOVERED:
        raise InvalidSpec(
            f"Port {port.name} covers only {100 * (1 - bare):.3g} % of its own convex outline: it runs over an edge of "
            "the envelope or is not convex, and a pipe on it would leak.",
            advice="Give the header a disk or a box that lies wholly on one face.",
            measured={"port": port.name, "uncovered": bare},
        )
    return header


def _uncovered(header: Header, samples: Array) -> float:
    """Share of the outline without a sample (S, 2) of the port nearby."""
    step = 1.0 / SAMPLES_ACROSS
    radii = header._outline(0.0) - step
    shares = np.sqrt((np.arange(24) + 0.5) / 24)  # rings of equal area
    points = (shares[:, None, None] * radii[:, None] * _directions()).reshape(-1, 2)
    weight = np.broadcast_to(radii**2, (len(shares), SIDES)).ravel()
    missed = cKDTree(samples).query(points)[0] > 1.5 * step
    return float(weight[missed].sum() / weight.sum())


def _stands_on(header: Header, other: Port) -> bool:
    """Whether a pipe's foot covers part of another port."""
    offset = other.samples - header.center
    height = offset @ header.axis
    facing = (offset @ header.across.T) @ header.sides.T <= header.reach + header.wall
    near = (height > header.low - 2 * header.wall) & (height < header.length)
    return bool((facing.all(axis=1) & near).any())


def _directions() -> Array:
    """(SIDES, 2) unit vectors, counter-clockwise."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _circle(radius: float) -> Array:
    """(SIDES,) radii of the polygon with the area of a round disk."""
    return np.full(SIDES, radius * np.sqrt(2 * np.pi / SIDES / np.sin(2 * np.pi / SIDES)))


def _loft(rings: list[Array]) -> TriangleMesh:
    """The closed mesh through rings (SIDES, 3) of rising height, its ends fans about their means."""
    vertices = np.concatenate([*rings, rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]])
    k = np.arange(SIDES)
    turn = (k + 1) % SIDES
    faces = [np.stack([np.full(SIDES, len(vertices) - 2), turn, k], axis=1)]
    for level in range(len(rings) - 1):
        a, b, c, d = (r + SIDES * (level + up) for up in (0, 1) for r in (k, turn))
        faces += [np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]
    top = SIDES * (len(rings) - 1)
    faces.append(np.stack([np.full(SIDES, len(vertices) - 1), top + k, top + turn], axis=1))
    return TriangleMesh(vertices, np.concatenate(faces).astype(np.int64))
