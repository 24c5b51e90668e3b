"""The preview of a body: cut open, both fluids, and the closed solid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dualms.body.body import Body, in_units
from dualms.body.patches import INTERFACE, WALL
from dualms.booleans import Solid
from dualms.render import Colour, camera, captioned, render
from dualms.triangles import TriangleMesh

HOT: Colour = (0.80, 0.20, 0.12)
COLD: Colour = (0.10, 0.32, 0.72)
METAL: Colour = (0.62, 0.63, 0.66)
CUT: Colour = (0.90, 0.90, 0.88)
SIDES = ((0, METAL), (1, HOT), (-1, COLD))
UNSEEN = 0.3  # pixels that the printed body's faces may move
CAPTION = 1 / 40  # height of the captions over the picture's width


def preview(body: Body, hot_bones: TriangleMesh, cold_bones: TriangleMesh, path: Path, width: int = 1280) -> None:
    """Write a picture with four views: cut open, the skeletons, both fluids, and the closed solid.

    Parameters
    ----------
    body
        In metres.
    hot_bones, cold_bones
        The two skeletons, in metres.
    path
        A PNG file.
    width
        Pixels across.
    """
    unit = float(np.ptp(body.solid.vertices, axis=0).max())
    body = in_units(body, unit)
    bones = [(mesh.moved(1 / unit, np.zeros(3)), colour) for mesh, colour in ((hot_bones, HOT), (cold_bones, COLD))]
    third, caption = width // 3, max(12, round(CAPTION * width))
    facing = _port_direction(body)
    solid = Solid.of_parts(body.solid, body.solid_side + 1).simplified(UNSEEN / width)
    printed, face_side = _sides(solid, solid)
    sides = {s: printed.part(face_side == s) for s, _ in SIDES}
    whole, small = (width, int(0.5 * width)), (third, int(0.8 * third))
    views = (
        ("Cut open: hot side red, cold side blue", _cut_open(solid), whole, None),
        ("Skeletons", bones, small, facing),
        ("Hot and cold fluid", [*((sides[s], c) for s, c in SIDES if s), *openings(body)], small, facing),
        ("The printed body", [(sides[s], c) for s, c in SIDES], small, facing),
    )
    pictures = []
    for title, parts, size, side in views:
        points = np.concatenate([mesh.vertices for mesh, _ in parts])
        pictures.append(captioned(render(parts, camera(points, size, side), size), title, caption))
    sheet = Image.new("RGB", (width, pictures[0].height + pictures[1].height), "white")
    sheet.paste(pictures[0], (0, 0))
    for k, picture in enumerate(pictures[1:]):
        sheet.paste(picture, (k * third, pictures[0].height))
    sheet.save(path, optimize=True)


def _sides(solid: Solid, of: Solid) -> tuple[TriangleMesh, NDArray[np.int64]]:
    """A boundary, and (F,) the side of each face in the body ``of`` that it was cut from; 2 where it was cut."""
    mesh, origin = solid.faces_by_origin()
    side = origin - of.origin - 1
    return mesh, np.where(np.abs(side) > 1, 2, side)


def openings(body: Body) -> list[tuple[TriangleMesh, Colour]]:
    """What the hot and the cold fluid's boundary has beside the solid's faces on its side."""
    inner = WALL if body.shell_m else INTERFACE
    return [(fluid.mesh.part(fluid.patch > inner), colour) for fluid, colour in ((body.hot, HOT), (body.cold, COLD))]


def _cut_open(solid: Solid) -> list[tuple[TriangleMesh, Colour]]:
    """The lower half along the shortest side, its cut faces bright."""
    points = solid.mesh().vertices
    axis = int(np.ptp(points, axis=0).argmin())
    normal = np.zeros(3)
    normal[axis] = -1.0
    height = 0.5 * (points[:, axis].min() + points[:, axis].max())
    cut, side = _sides(Solid(solid.manifold.trim_by_plane(tuple(normal), -float(height)), -1), solid)
    return [(cut.part(side == s), colour) for s, colour in (*SIDES, (2, CUT))]


def _port_direction(body: Body) -> NDArray[np.float64]:
    """(3,) where most of the ports' area faces; zero where they face in opposite directions."""
    faces = [fluid.mesh.crosses[fluid.patch > WALL].sum(axis=0) for fluid in (body.hot, body.cold)]
    total = np.asarray(sum(faces), dtype=float)
    length = float(np.linalg.norm(total))
    area = sum(fluid.mesh.areas[fluid.patch > WALL].sum() for fluid in (body.hot, body.cold))
    return total / length if length > area else np.zeros(3)
