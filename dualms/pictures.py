"""Pictures of a body, rendered by path tracing on the CPU (Mitsuba 3): no display and no graphics driver needed."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dualms.body.body import Body, in_units
from dualms.body.patches import WALL
from dualms.booleans import Solid
from dualms.triangles import TriangleMesh

Colour = tuple[float, float, float]

HOT: Colour = (0.80, 0.20, 0.12)
COLD: Colour = (0.10, 0.32, 0.72)
METAL: Colour = (0.62, 0.63, 0.66)
CUT: Colour = (0.90, 0.90, 0.88)
SAMPLES_PER_PIXEL = 12


def preview(body: Body, path: Path, width: int) -> None:
    """Write a picture with three views: cut open, both fluids, and the closed solid.

    Parameters
    ----------
    body
        In metres.
    path
        A PNG file.
    width
        Pixels across.
    """
    # Mitsuba's near plane and ray offsets are absolute: bring the body to size 1.
    body = in_units(body, float(np.ptp(body.solid.vertices, axis=0).max()))
    half = width // 2
    wide = int(0.5 * width)
    views = (
        ("cut open", _cut_open(body), (width, wide)),
        ("hot and cold fluid", [(body.hot.mesh, HOT), (body.cold.mesh, COLD)], (half, int(0.6 * half))),
        ("solid", [(body.solid.part(body.solid_side == s), c) for s, c in _SIDES], (width - half, int(0.6 * half))),
    )
    cameras = (_camera(body.solid.vertices), *(2 * [_camera(body.solid.vertices, _port_direction(body))]))
    pictures = [
        _labelled(render(parts, camera, size), title)
        for (title, parts, size), camera in zip(views, cameras, strict=True)
    ]
    sheet = Image.new("RGB", (width, pictures[0].height + pictures[1].height), "white")
    sheet.paste(pictures[0], (0, 0))
    sheet.paste(pictures[1], (0, pictures[0].height))
    sheet.paste(pictures[2], (half, pictures[0].height))
    sheet.save(path, optimize=True)


_SIDES = ((0, METAL), (1, HOT), (-1, COLD))


def render(parts: Sequence[tuple[TriangleMesh, Colour]], camera: dict[str, Any], size: tuple[int, int]) -> Image.Image:
    """Render coloured meshes.

    Parameters
    ----------
    parts
        Meshes with their diffuse colours (linear RGB, 0 to 1).
    camera
        ``origin``, ``target``, ``up`` and ``radius`` of what must be seen, in the meshes' frame.
    size
        Width and height in pixels.
    """
    if mitsuba.variant() != "scalar_rgb":
        mitsuba.set_variant("scalar_rgb")
    transform = mitsuba.ScalarTransform4f
    origin, target = np.array(camera["origin"]), np.array(camera["target"])
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "hide_emitters": True},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.55}},
        "sun": {"type": "directional", "direction": (target - origin + camera["right"]).tolist(), "irradiance": 1.4},
        "sensor": {
            "type": "perspective",
            "fov": 26.0,
            "fov_axis": "smaller",
            "to_world": transform().look_at(origin.tolist(), target.tolist(), camera["up"]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "pixel_format": "rgba"},
            "sampler": {"type": "multijitter", "sample_count": SAMPLES_PER_PIXEL},
        },
    }
    with tempfile.TemporaryDirectory() as folder:
        for k, (mesh, colour) in enumerate(parts):
            if len(mesh.faces) == 0:
                continue
            file = Path(folder) / f"{k}.ply"
            _as_mitsuba(mesh).write_ply(str(file))
            material = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}
            scene[f"part{k}"] = {
                "type": "ply",
                "filename": str(file),
                "face_normals": True,
                "material": {"type": "twosided", "inner": material},
            }
        pixels = np.array(mitsuba.render(mitsuba.load_dict(scene)))
    alpha = pixels[..., 3:]
    linear = np.clip(pixels[..., :3] + (1 - alpha), 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return Image.fromarray((255 * encoded + 0.5).astype(np.uint8))


def _cut_open(body: Body) -> list[tuple[TriangleMesh, Colour]]:
    """The lower half along the shortest side, its cut faces bright."""
    points = body.solid.vertices
    axis = int(np.ptp(points, axis=0).argmin())
    normal = np.zeros(3)
    normal[axis] = -1.0
    height = 0.5 * (points[:, axis].min() + points[:, axis].max())
    solid = Solid.of(body.solid)
    cut = Solid(solid.manifold.trim_by_plane(tuple(normal), -float(height)), -1).mesh()
    middle = cut.centroids
    on_plane = (np.abs(cut.vertices[cut.faces][:, :, axis] - height) < 1e-7 * np.ptp(points)).all(axis=1)
    side = _nearest_side(body, middle)
    return [(cut.part(on_plane), CUT), *((cut.part(~on_plane & (side == s)), c) for s, c in _SIDES)]


def _nearest_side(body: Body, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Side of the solid's face that each point lies on."""
    import igl

    _, face, _ = igl.point_mesh_squared_distance(np.ascontiguousarray(points), body.solid.vertices, body.solid.faces)
    return np.asarray(body.solid_side[face])


def _port_direction(body: Body) -> NDArray[np.float64]:
    """(3,) where most of the ports' area faces; zero where they face in opposite directions."""
    faces = [fluid.mesh.crosses[fluid.patch > WALL].sum(axis=0) for fluid in (body.hot, body.cold)]
    total = np.asarray(sum(faces), dtype=float)
    length = float(np.linalg.norm(total))
    area = sum(fluid.mesh.areas[fluid.patch > WALL].sum() for fluid in (body.hot, body.cold))
    return total / length if length > area else np.zeros(3)


def _camera(points: NDArray[np.float64], ports: NDArray[np.float64] | None = None) -> dict[str, Any]:
    """A view from above the two longest sides, turned to the ports if there is a side that they face."""
    low, high = points.min(axis=0), points.max(axis=0)
    up = int((high - low).argmin())
    long = int((high - low).argmax())
    side = ({0, 1, 2} - {up, long}).pop() if up != long else (up + 1) % 3
    axes = np.eye(3)
    radius = float(np.linalg.norm(high - low)) / 2
    target = (low + high) / 2
    left_handed = np.linalg.det(np.stack([axes[long], axes[side], axes[up]])) < 0
    direction = 1.6 * axes[up] + (1.0 if left_handed else -1.0) * axes[side] - 0.25 * axes[long]
    if ports is not None and ports.any():
        level = ports - ports[up] * axes[up]
        direction = 1.0 * axes[up] - 0.8 * np.cross(axes[up], level) + 1.4 * level
    direction /= np.linalg.norm(direction)
    flat = ports is None  # seen from above, a body is no higher than its second side
    origin = target + (3.4 if flat else 4.1) * radius * direction
    right = 0.8 * radius * np.cross(direction, axes[up])
    return {"origin": origin.tolist(), "target": target.tolist(), "up": axes[up].tolist(), "right": right}


def _as_mitsuba(mesh: TriangleMesh) -> Any:
    made = mitsuba.Mesh("part", len(mesh.vertices), len(mesh.faces))
    parameters = mitsuba.traverse(made)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return made


def _labelled(picture: Image.Image, text: str) -> Image.Image:
    font = ImageFont.load_default(size=max(14, picture.width // 60))
    ImageDraw.Draw(picture).text((picture.width // 50, picture.width // 80), text, fill=(70, 70, 70), font=font)
    return picture
