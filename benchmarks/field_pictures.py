"""Surfaces coloured by their mean curvature, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from dualms.measure.curvature import mean_curvature
from dualms.pictures import Colour, render
from dualms.triangles import TriangleMesh

BINS = 17
VIEW = {"direction": np.array([-0.45, -1.0, 0.7]), "size": 420}

Shown = tuple[str, np.ndarray, np.ndarray]


def by_curvature(surfaces: list[Shown], limit: float, path: Path, columns: int = 4) -> None:
    """Write a sheet of pictures: blue for H ≤ -limit, white for 0, red for H ≥ limit.

    Parameters
    ----------
    surfaces
        Title, vertices and faces of each.
    limit
        In 1 / unit of the vertices.
    path
        A PNG file.
    columns
        Pictures in a row.
    """
    size = int(VIEW["size"])
    rows = -(-len(surfaces) // columns)
    sheet = Image.new("RGB", (size * min(columns, len(surfaces)), size * rows), "white")
    font = ImageFont.load_default(size=16)
    for n, (title, vertices, faces) in enumerate(surfaces):
        h = np.nan_to_num(mean_curvature(vertices, faces))
        level = np.clip(np.rint((h[faces].mean(axis=1) / limit + 1) / 2 * (BINS - 1)), 0, BINS - 1)
        mesh = TriangleMesh(vertices, faces)
        parts = [(mesh.part(level == k), _colour(2 * k / (BINS - 1) - 1)) for k in range(BINS)]
        picture = render(parts, _camera(vertices), (size, size))
        ImageDraw.Draw(picture).text((10, 6), f"{title}\n|H| < {limit:g}", fill=(60, 60, 60), font=font)
        sheet.paste(picture, (size * (n % columns), size * (n // columns)))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, optimize=True)


def _colour(x: float) -> Colour:
    """Blue to white to red for x from -1 to 1, linear RGB."""
    fade = 0.85 * (1 - abs(x))
    return (0.85, fade, fade) if x > 0 else (fade, fade, 0.85)


def _camera(vertices: np.ndarray) -> dict[str, object]:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    target, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    direction = VIEW["direction"] / np.linalg.norm(VIEW["direction"])
    right = 0.8 * radius * np.cross(direction, [0.0, 0.0, 1.0])
    return {
        "origin": (target + 4.4 * radius * direction).tolist(),
        "target": target.tolist(),
        "up": [0, 0, 1],
        "right": right,
    }
