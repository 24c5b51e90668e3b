"""A header: a stub pipe that carries a port out of the envelope, tapering from its outline to a round end.

A pipe is a loft of rings about the port's axis. Its bore starts just above the body's skin, where the opening through
the shell ends, so nothing that belongs to the other fluid is ever cut. A taper stands at 45° or steeper: it needs no
support when printed upright, and the flow follows it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dualms.booleans import Solid
from dualms.boundary import SAMPLES_ACROSS
from dualms.grid import Grid
from dualms.ports import Port
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

SIDES = 128  # of a ring; its circles have the area of the round pipe
LIFT_VOXELS = 1.0  # the bore starts so far above the skin, clear of its sharp edges as voxels see them
STRAIGHT_VOXELS = 3.0  # the port's outline is kept so far above the skin, then the taper begins


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
            ring = circle(radius)
            plate = _loft([self._placed(ring, np.full(SIDES, h)) for h in (end - thickness, end)])
            body = Solid.of((body | Solid.of(plate)).mesh())
        return body

    def above(self, grid: Grid, skin: float) -> Solid:
        """The part of the pipe that must be clear of the body."""
        turn, end = self._turn(grid, skin), skin + self.length
        return self._loft(None, turn, turn + self._taper(), end, self.wall)

    def needed(self, grid: Grid, skin: float) -> float:
        """Least length that holds outline, taper and flange."""
        turned = self.wall * np.tan(np.pi / 8)  # the outer surface turns a little later than the bore
        return self._turn(grid, skin) - skin + self._taper() + max(self.flange[1], float(turned))

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

    def outline(self, grow: float) -> Array:
        """(SIDES,) distance of the outline from the axis, its sides moved outward by ``grow``."""
        facing = self.sides @ directions().T
        along = np.where(facing > 1e-6, (self.reach[:, None] + grow) / np.maximum(facing, 1e-6), np.inf)
        return np.asarray(along.min(axis=0))

    def _turn(self, grid: Grid, skin: float) -> float:
        return self.high + skin + STRAIGHT_VOXELS * grid.spacing

    def _taper(self) -> float:
        return float(np.abs(self.outline(0.0) - circle(self.radius)).max())

    def _loft(self, below: float | None, turn: float, narrow: float, end: float, wall: float) -> Solid:
        """Rings from the outline to the circle, grown by ``wall`` measured across the pipe's own surface."""
        outline, end_circle = self.outline(wall), circle(self.radius + wall)
        # Half the angle of the taper, side by side: where the grown surface turns.
        slope = np.arctan2(self.outline(0.0) - circle(self.radius), max(narrow - turn, 1e-12))
        shift = wall * np.tan(slope / 2)
        rings = [] if below is None else [self._placed(outline, np.full(SIDES, below))]
        rings.append(self._placed(outline, turn + shift))
        if self._taper() > 1e-9:
            rings.append(self._placed(end_circle, narrow + shift))
        rings.append(self._placed(end_circle, np.full(SIDES, end)))
        return Solid.of(_loft(rings))

    def _placed(self, radii: Array, heights: Array) -> Array:
        flat = (radii[:, None] * directions()) @ self.across
        return np.asarray(self.center + flat + heights[:, None] * self.axis)


def directions() -> Array:
    """(SIDES, 2) unit vectors, counter-clockwise."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def circle(radius: float) -> Array:
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
