"""Triangles keep the part that they were given through booleans."""

import numpy as np
import pytest
import trimesh

from dualms.booleans import Solid
from dualms.errors import InvalidBody
from dualms.triangles import TriangleMesh


def test_parts_are_told_apart_after_a_cut() -> None:
    box = trimesh.creation.box((1, 1, 1))
    mesh = TriangleMesh(np.array(box.vertices), np.array(box.faces))
    axis = np.abs(mesh.crosses).argmax(axis=1)  # one part for each pair of opposite faces
    whole = Solid.of_parts(mesh, axis)
    upper = TriangleMesh(mesh.vertices + np.array([0, 0, 0.75]), mesh.faces)
    cut, origin = (whole - Solid.of(upper)).faces_by_origin()
    areas = [cut.areas[origin == whole.origin + k].sum() for k in range(3)]
    assert areas == pytest.approx([1.5, 1.5, 1.0])  # sides three quarters high, the bottom whole
    assert cut.area - sum(areas) == pytest.approx(1.0)  # the cut's own face


def test_a_mesh_inside_out_is_refused() -> None:
    box = trimesh.creation.box((1, 1, 1))
    with pytest.raises(InvalidBody, match="inside out"):
        Solid.of(TriangleMesh(np.array(box.vertices), np.array(box.faces)[:, ::-1]))
