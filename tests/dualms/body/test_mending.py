"""Short edges collapsed and flat triangles flipped: closed meshes stay closed, and nothing else moves."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dualms.body.collapse import collapsed
from dualms.body.flip import flipped
from dualms.body.written import as_written
from dualms.booleans import Solid
from dualms.triangles import TriangleMesh


@pytest.fixture
def ball() -> TriangleMesh:
    made = trimesh.creation.icosphere(3)
    return TriangleMesh(np.asarray(made.vertices, dtype=float), np.asarray(made.faces, dtype=np.int64))


def test_collapsing_leaves_a_closed_mesh_without_short_edges(ball: TriangleMesh) -> None:
    shortest = np.linalg.norm(np.diff(ball.vertices[ball.faces[:, :2]], axis=1), axis=2).min()
    bent = ball.vertices.copy()
    a, b = ball.faces[100, :2]
    bent[a] = bent[b] + 0.01 * (bent[a] - bent[b])
    mesh, kept, moved = collapsed(TriangleMesh(bent, ball.faces), 0.1 * shortest)
    assert mesh.is_closed
    assert len(mesh.faces) == len(ball.faces) - 2 == kept.sum()
    assert 0 < moved.sum() < 8
    stayed = ball.faces[kept][~moved]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[~moved]], bent[stayed])


@pytest.mark.parametrize("least", [0.1, 0.3, 0.5, 1.0, 2.5])
def test_collapsing_keeps_a_ball_a_ball(ball: TriangleMesh, least: float) -> None:
    mesh, kept, _ = collapsed(ball, least)
    assert mesh.is_closed
    assert kept.sum() == len(mesh.faces) < len(ball.faces) or least == 0.1
    edges = 3 * len(mesh.faces) // 2
    assert len(mesh.vertices) - edges + len(mesh.faces) == 2 or len(mesh.faces) == 2


def test_a_corner_on_an_edge_is_joined_to_the_other_side(ball: TriangleMesh) -> None:
    # A new vertex within a thousandth of an edge's middle, given to one side of the edge alone.
    a, b, c = ball.faces[50]
    middle = (ball.vertices[a] + ball.vertices[b]) / 2 + 1e-3 * (ball.vertices[c] - ball.vertices[a])
    new = len(ball.vertices)
    faces = np.concatenate([np.delete(ball.faces, 50, axis=0), [[a, b, new], [b, c, new], [c, a, new]]])
    flat = TriangleMesh(np.concatenate([ball.vertices, [middle]]), faces)
    assert flat.areas.min() < 1e-2 * np.median(flat.areas)
    mesh, origin, turned = flipped(flat, np.arange(len(faces)), 1e-2, np.ones(len(faces), dtype=bool))
    assert mesh.is_closed
    assert mesh.areas.min() > 0.1 * np.median(mesh.areas)
    assert turned.sum() == 2
    assert len(np.unique(origin[turned])) == 1  # both are parts of what was the neighbour
    assert mesh.volume == pytest.approx(ball.volume, rel=1e-4)


def test_two_triangles_back_to_back_are_dropped() -> None:
    # A tetrahedron of a few steps of single precision beside a box: closing it up leaves nothing of it.
    box = trimesh.creation.box((1, 1, 1))
    tiny = np.array([[2, 0, 0], [2 + 4e-7, 0, 0], [2, 4e-7, 0], [2, 0, 4e-7]], dtype=float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    both = Solid.of(TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int64))) | Solid.of(
        TriangleMesh(tiny, faces)
    )
    mesh, _, crossing = as_written(both, 100.0, np.zeros(3))
    assert crossing == 0
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(1e6, rel=1e-6)
    assert len(mesh.shell_volumes()) == 1


def test_shells_have_their_volumes_and_cavities_negative_ones() -> None:
    outer, inner = trimesh.creation.box((3, 3, 3)), trimesh.creation.box((1, 1, 1))
    inner.invert()
    both = trimesh.util.concatenate([outer, inner])
    mesh = TriangleMesh(np.asarray(both.vertices), np.asarray(both.faces, dtype=np.int64))
    assert sorted(mesh.shell_volumes()) == pytest.approx([-1, 27])
