"""Rendering by path tracing on the CPU (Mitsuba 3): no display and no graphics driver needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

SAMPLES_PER_PIXEL = 4
FILTER_PIXELS = 0.7  # standard deviation of the filter between samples: about as little grain as nine at 0.5
FIELD_OF_VIEW = 26.0  # degrees, of the picture's smaller side
FILLED = 0.96  # of the picture


@dataclass(frozen=True)
class Camera:
    """Where a scene is seen from.

    Parameters
    ----------
    origin, target
        (3,) the eye, and what it looks at.
    up
        (3,) unit vector that points up in the picture.
    sun
        (3,) direction in which the light shines, of any length.
    """

    origin: Array
    target: Array
    up: Array
    sun: Array


def camera(points: Array, size: tuple[int, int], facing: Array | None = None) -> Camera:
    """A view from above the two longest sides of points (P, 3) that fills a picture of a size.

    Parameters
    ----------
    points
        What must be seen.
    size
        Width and height of the picture.
    facing
        (3,) direction to turn to, if it is that of a side.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    up = int((high - low).argmin())
    long = int((high - low).argmax())
    side = ({0, 1, 2} - {up, long}).pop() if up != long else (up + 1) % 3
    axes = np.eye(3)
    left_handed = np.linalg.det(np.stack([axes[long], axes[side], axes[up]])) < 0
    direction = 1.6 * axes[up] + (1.0 if left_handed else -1.0) * axes[side] - 0.25 * axes[long]
    if facing is not None and facing.any():
        level = facing - facing[up] * axes[up]
        direction = 1.0 * axes[up] - 0.8 * np.cross(axes[up], level) + 1.4 * level
    direction /= np.linalg.norm(direction)
    right = np.cross(axes[up], direction)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(direction, right), direction])
    seen = points @ frame.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    half = np.tan(np.radians(FIELD_OF_VIEW / 2)) * FILLED * np.array(size) / min(size)
    for _ in range(4):
        # The nearer of what is seen looks larger: centre what the picture shows, not the points themselves.
        offset = seen - middle
        distance = float((np.abs(offset[:, :2]) / half + offset[:, 2:]).max())
        shown = offset[:, :2] / (distance - offset[:, 2:])
        middle[:2] += distance * (shown.min(axis=0) + shown.max(axis=0)) / 2
    target = middle @ frame
    origin = target + distance * direction
    return Camera(origin, target, axes[up], -direction - 0.24 * right)


def render(parts: Sequence[tuple[TriangleMesh, Colour | Array]], view: Camera, size: tuple[int, int]) -> Image.Image:
    """Render coloured meshes on white.

    Parameters
    ----------
    parts
        Meshes with their diffuse colours (linear RGB, 0 to 1): one each, or one a vertex (V, 3).
    view
        In the meshes' frame, whose size should be about 1: Mitsuba's near plane and ray offsets are absolute.
    size
        Width and height in pixels.
    """
    if mitsuba.variant() != "scalar_rgb":
        mitsuba.set_variant("scalar_rgb")
    transform = mitsuba.ScalarTransform4f
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "hide_emitters": True},
        # The sun is asked for at every sample; the sky where a ray scattered by the surface leaves the scene.
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.55}, "sampling_weight": 0.0},
        "sun": {"type": "directional", "direction": view.sun.tolist(), "irradiance": 1.4},
        "sensor": {
            "type": "perspective",
            "fov": FIELD_OF_VIEW,
            "fov_axis": "smaller",
            "to_world": transform().look_at(view.origin.tolist(), view.target.tolist(), view.up.tolist()),
            "film": {
                "type": "hdrfilm",
                "width": size[0],
                "height": size[1],
                "pixel_format": "rgba",
                "filter": {"type": "gaussian", "stddev": FILTER_PIXELS},
            },
            "sampler": {"type": "multijitter", "sample_count": SAMPLES_PER_PIXEL},
        },
    }
    for k, (mesh, colour) in enumerate(parts):
        if len(mesh.faces):
            scene[f"part{k}"] = _shape(mesh, colour)
    pixels = np.array(mitsuba.render(mitsuba.load_dict(scene)))
    alpha = pixels[..., 3:]
    linear = np.clip(pixels[..., :3] + (1 - alpha), 0, 1)
    return Image.fromarray((255 * encoded(linear) + 0.5).astype(np.uint8))


def encoded(linear: NDArray[np.floating]) -> Array:
    """Linear light as sRGB, both 0 to 1."""
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


def decoded(shade: NDArray[np.floating]) -> Array:
    """The inverse of :func:`encoded`."""
    return np.asarray(np.where(shade <= 0.04045, shade / 12.92, ((shade + 0.055) / 1.055) ** 2.4))


def captioned(picture: Image.Image, text: str, height: int) -> Image.Image:
    """A picture under a line of text of a height in pixels."""
    sheet = Image.new("RGB", (picture.width, picture.height + 2 * height), "white")
    sheet.paste(picture, (0, 2 * height))
    font = ImageFont.load_default(size=height)
    ImageDraw.Draw(sheet).text((height, height // 2), text, fill=(40, 46, 58), font=font)
    return sheet


def _shape(mesh: TriangleMesh, colour: Colour | Array) -> Any:
    properties = mitsuba.Properties()
    painted = np.ndim(colour) == 2
    shade = {"type": "mesh_attribute", "name": "vertex_color"} if painted else {"type": "rgb", "value": list(colour)}
    inner = {"type": "diffuse", "reflectance": shade}
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "inner": inner})
    properties["face_normals"] = True
    made = mitsuba.Mesh("part", len(mesh.vertices), len(mesh.faces), props=properties)
    if painted:
        made.add_attribute("vertex_color", 3, [0.0] * np.size(colour))
    parameters = mitsuba.traverse(made)
    if painted:
        parameters["vertex_color"] = np.asarray(colour, dtype=np.float32).ravel()
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return made
