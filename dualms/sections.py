"""Cross-sections of the channels, at stations along the flow."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import manifold3d
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from dualms.body.body import Body
from dualms.domain import Domain
from dualms.flow import potential
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

STATIONS = 6
RESOLUTION = 40
LINE = 60  # points of the centre line
NEAR = 0.03  # width of a level, over the whole potential
FIRST = 0.1  # of the way: closer to a port a plane across the flow means little
COLOURS = {"solid": "#4a4f59", "hot": "#d64534", "cold": "#3470c4"}


@dataclass(frozen=True)
class Station:
    """A plane across the flow.

    Parameters
    ----------
    share
        Of the way from the hot inlets to the hot outlets, 0 to 1.
    point, direction
        (3,) middle of the section, unit-cube frame, and unit vector along the flow.
    """

    share: float
    point: Array
    direction: Array


@dataclass(frozen=True)
class Section:
    """What a station's plane cuts, in the plane's own axes and the body's unit.

    Parameters
    ----------
    areas
        Of ``solid``, ``hot`` and ``cold``.
    outlines
        For each of them its closed polygons (K, 2).
    """

    areas: dict[str, float]
    outlines: dict[str, list[Array]]


def stations(domain: Domain, count: int = STATIONS) -> list[Station]:
    """Planes at equal steps along the centre line of the potential flow from the hot inlets to the hot outlets.

    The line's tangent is taken over a tenth of its length to both sides: close to a port that sits beside the middle,
    the flow runs askew.
    """
    grid = domain.grid(RESOLUTION)
    inside = domain.inside(grid)
    ends = [
        np.unique(
            np.concatenate(
                [
                    touched
                    for touched, port in zip(domain.port_voxels(grid, inside), domain.ports, strict=True)
                    if port.fluid == 1 and port.inlet is inlet
                ]
            ),
            axis=0,
        )
        for inlet in (True, False)
    ]
    level, _ = potential(inside, *ends)
    # Each point of the line is the middle of what lies near a level; levels hold equal volumes between them.
    steps = np.quantile(level, np.linspace(1, 0, LINE))
    weight = np.exp(-(((level - steps[:, None]) / NEAR) ** 2))
    line = weight @ grid.points(inside) / weight.sum(axis=1)[:, None]
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])

    def at(share: Array) -> Array:
        return np.stack([np.interp(share * length[-1], length, line[:, k]) for k in range(3)], axis=-1)

    shares = FIRST + (1 - 2 * FIRST) * np.arange(count) / max(count - 1, 1)
    along = at(shares + 0.1) - at(shares - 0.1)
    along /= np.linalg.norm(along, axis=1)[:, None]
    return [Station(float(s), p, d) for s, p, d in zip(shares, at(shares), along, strict=True)]


def section(body: Body, point: Array, direction: Array) -> Section:
    """Cut a body and its fluids by a plane.

    Parameters
    ----------
    body
        In any unit.
    point, direction
        (3,) of the plane, in that unit; of the body's parts in the plane, the one nearest to the point is kept.
    """
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    turn = np.stack([first, np.cross(direction, first), direction])
    cuts = {
        name: _slice(mesh, turn, point)
        for name, mesh in (("solid", body.solid), ("hot", body.hot.mesh), ("cold", body.cold.mesh))
    }
    whole = (cuts["solid"] + cuts["hot"] + cuts["cold"]).decompose()
    if whole:
        middle = min(whole, key=_gap)
        # The hull of one part may reach over a gap, but not into another part of an embracing body such as a U.
        cuts = {name: cut ^ middle for name, cut in cuts.items()}
    return Section(
        {name: float(cut.area()) for name, cut in cuts.items()},
        {name: [np.asarray(p) for p in cut.to_polygons()] for name, cut in cuts.items()},
    )


def sections_picture(domain: Domain, body: Body, path: Path, count: int = STATIONS) -> None:
    """Write ``sections.png``: what lies across the flow at stations from the hot inlets to the hot outlets.

    Parameters
    ----------
    domain
        For the way of the flow.
    body
        In metres.
    path
        A PNG file.
    """
    rows = 2
    figure = Figure(figsize=(12.8, 8.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, -(-count // rows)).ravel()
    cuts = [
        (s, section(body, domain.offset_m + domain.scale_m * s.point, s.direction)) for s in stations(domain, count)
    ]
    reach = 1e3 * max(
        (float(np.abs(p).max()) for _, cut in cuts for ps in cut.outlines.values() for p in ps), default=1.0
    )
    for axis, (station, cut) in zip(axes, cuts, strict=False):
        for name, polygons in cut.outlines.items():
            if polygons:
                patch = axis.add_artist(PathPatch(_path(polygons), facecolor=COLOURS[name], edgecolor="none"))
                patch.set_in_layout(False)  # its long outline lies within the axes
        total = sum(cut.areas.values())
        shares = ", ".join(f"{name} {100 * a / total:.0f} %" for name, a in cut.areas.items()) if total else "nothing"
        axis.set_title(f"{100 * station.share:.0f} % of the way\n{shares}", fontsize=14)
        axis.set_xlim(-1.05 * reach, 1.05 * reach)
        axis.set_ylim(-1.05 * reach, 1.05 * reach)
        axis.set_aspect("equal")
        axis.tick_params(labelsize=11)
        axis.set_xlabel("mm", fontsize=12)
    for axis in axes[count:]:
        axis.set_axis_off()
    figure.savefig(path, dpi=100)


def _slice(mesh: TriangleMesh, turn: Array, point: Array) -> manifold3d.CrossSection:
    """The section of a closed mesh by the plane z = 0 of the turned frame."""
    height = (mesh.vertices - point) @ turn[2]
    above = height > 0
    count = above[mesh.faces].sum(axis=1)
    faces = mesh.faces[(count == 1) | (count == 2)]
    if len(faces) == 0:
        return manifold3d.CrossSection()
    # Each face is crossed on its way up and on its way down; its neighbour meets the same edge the other way round.
    rows, up = np.arange(len(faces)), above[faces]
    ends = []
    for rising in (True, False):
        corner = ((up != rising) & (np.roll(up, -1, axis=1) == rising)).argmax(axis=1)
        ends.append(np.sort(np.stack([faces[rows, corner], faces[rows, (corner + 1) % 3]], axis=1), axis=1))
    keys = [pairs[:, 0] * len(mesh.vertices) + pairs[:, 1] for pairs in ends]
    order = np.argsort(keys[1])
    following = order[np.searchsorted(keys[1], keys[0], sorter=order)]
    low, high = ends[1].T
    share = (height[low] / (height[low] - height[high]))[:, None]
    flat = (mesh.vertices[low] + share * (mesh.vertices[high] - mesh.vertices[low]) - point) @ turn[:2].T
    return manifold3d.CrossSection([flat[loop] for loop in _loops(following)], manifold3d.FillRule.Positive)


def _loops(following: NDArray[np.int64]) -> list[list[int]]:
    """The cycles of a permutation."""
    after, seen, loops = following.tolist(), [False] * len(following), []
    for start in range(len(after)):
        if seen[start]:
            continue
        loop, at = [], start
        while not seen[at]:
            seen[at] = True
            loop.append(at)
            at = after[at]
        loops.append(loop)
    return loops


def _gap(part: manifold3d.CrossSection) -> float:
    """How far a part lies from the plane's origin."""
    return min(float(np.linalg.norm(polygon, axis=1).min()) for polygon in part.to_polygons())


def _path(polygons: list[Array]) -> Outline:
    """One path of closed polygons; holes turn the other way round."""
    codes = [
        np.concatenate([[Outline.MOVETO], np.full(len(p) - 1, Outline.LINETO), [Outline.CLOSEPOLY]]) for p in polygons
    ]
    points = [1e3 * np.concatenate([p, p[:1]]) for p in polygons]
    return Outline(np.concatenate(points), np.concatenate(codes))
