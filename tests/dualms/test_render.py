"""The camera fills the picture, and colours come out as given."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dualms.render import FILLED, camera, decoded, encoded, render
from dualms.triangles import TriangleMesh


@pytest.mark.parametrize("size", [(160, 80), (90, 120)])
@pytest.mark.parametrize("extent", [(1.0, 0.6, 0.2), (0.3, 0.9, 1.0)])
def test_what_is_seen_fills_the_frame_and_stays_in_it(size: tuple[int, int], extent: tuple[float, ...]) -> None:
    box = trimesh.creation.box(extent)
    mesh = TriangleMesh(box.vertices + np.array([3.0, -1.0, 2.0]), box.faces.astype(np.int64))
    view = camera(mesh.vertices, size)
    drawn = np.asarray(render([(mesh, (0.1, 0.1, 0.1))], view, size).convert("L")) < 250
    across, down = np.flatnonzero(drawn.any(axis=0)), np.flatnonzero(drawn.any(axis=1))
    filled = max(np.ptp(across) / size[0], np.ptp(down) / size[1])
    assert filled == pytest.approx(FILLED, abs=0.05)
    # Even margins.
    assert abs(across[0] + across[-1] - size[0] + 1) <= 4
    assert abs(down[0] + down[-1] - size[1] + 1) <= 4


def test_a_vertexs_colour_is_seen_on_its_side() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    mesh = TriangleMesh(np.asarray(ball.vertices), ball.faces.astype(np.int64))
    red, blue = np.array([0.8, 0.05, 0.05]), np.array([0.05, 0.05, 0.8])
    view = camera(mesh.vertices, (60, 60))
    right = np.cross(view.target - view.origin, view.up)
    colours = np.where((mesh.vertices @ right > 0)[:, None], red, blue)
    pixels = np.asarray(render([(mesh, colours)], view, (60, 60))).astype(int)
    assert pixels[30, 45, 0] > pixels[30, 45, 2] + 60
    assert pixels[30, 15, 2] > pixels[30, 15, 0] + 60


def test_srgb_comes_back() -> None:
    shade = np.linspace(0, 1, 50)
    np.testing.assert_allclose(encoded(decoded(shade)), shade, atol=1e-6)
