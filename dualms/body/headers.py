"""The headers of a specification: found on their ports, refused where they would leak or collide."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from dualms.body.header import SIDES, Header, circle, directions
from dualms.booleans import Solid
from dualms.boundary import SAMPLES_ACROSS
from dualms.domain import Domain
from dualms.errors import InvalidSpec
from dualms.grid import Grid
from dualms.ports import Port
from dualms.spec import FluidsSpec, HeaderSpec, ShellSpec, Unit

Array = NDArray[np.float64]

UNCOVERED = 0.03  # share of the outline that may miss the port: it is sampled, and disks are sampled at their rim


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
    normal = port.normal
    if port.shape == "box":  # its sides are the frame's
        axis = int(np.abs(normal).argmax())
        normal = np.sign(normal[axis]) * np.eye(3)[axis]
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    across = np.stack([first, np.cross(normal, first)])
    flat = port.samples @ across.T
    if port.shape == "disk":
        middle = across @ port.extent[0]
        sides, reach = directions(), circle(port.extent[1, 0])
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
    radii = header.outline(0.0) - step
    shares = np.sqrt((np.arange(24) + 0.5) / 24)  # rings of equal area
    points = (shares[:, None, None] * radii[:, None] * directions()).reshape(-1, 2)
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
