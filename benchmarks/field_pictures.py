"""Surfaces coloured by their mean curvature, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from dualms.measure.curvature import mean_curvature
from dualms.render import Camera, render
from dualms.triangles import TriangleMesh

EYE = np.array([-0.45, -1.0, 0.7])
"""Direction from what is seen to the eye."""
SIZE = 420

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
    rows = -(-len(surfaces) // columns)
    sheet = Image.new("RGB", (SIZE * min(columns, len(surfaces)), SIZE * rows), "white")
    font = ImageFont.load_default(size=16)
    for n, (title, vertices, faces) in enumerate(surfaces):
        share = np.clip(np.nan_to_num(mean_curvature(vertices, faces)) / limit, -1, 1)
        picture = render([(TriangleMesh(vertices, faces), _colours(share))], _camera(vertices[faces]), (SIZE, SIZE))
        ImageDraw.Draw(picture).text((10, 6), f"{title}\n|H| < {limit:g}", fill=(60, 60, 60), font=font)
        sheet.paste(picture, (SIZE * (n % columns), SIZE * (n // columns)))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.quantize(255).save(path, optimize=True)


def _colours(share: np.ndarray) -> np.ndarray:
    """(V, 3) blue to white to red for shares from -1 to 1, linear RGB."""
    fade = 0.85 * (1 - np.abs(share))
    full = np.full(share.shape, 0.85)
    return np.stack([np.where(share > 0, full, fade), fade, np.where(share > 0, fade, full)], axis=1)


def _camera(corners: np.ndarray) -> Camera:
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    target, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    direction = EYE / np.linalg.norm(EYE)
    right = np.cross([0.0, 0.0, 1.0], direction)
    return Camera(target + 4.4 * radius * direction, target, np.array([0.0, 0.0, 1.0]), -direction - 0.24 * right)
