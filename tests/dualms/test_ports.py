"""Ports: resolved areas equal the shapes' areas, and what is ambiguous is refused."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dualms.boundary import SAMPLES_ACROSS, boundary_samples
from dualms.errors import InvalidSpec, OverlappingPorts, PortNotOnBoundary
from dualms.mesh import DomainMesh
from dualms.ports import resolve_ports
from dualms.spec import FluidsSpec, Unit
from tests.dualms.shapes import box_mesh, end_ports, shared_ends


def _fluids(hot_in: dict[str, object], **others: dict[str, object]) -> FluidsSpec:
    base = end_ports().model_dump()
    base["hot"]["inlets"] = [hot_in]
    for key, port in others.items():
        fluid, role = key.split("_")
        base[fluid][role] = [port]
    return FluidsSpec.model_validate(base)


def test_a_disk_covers_its_area_and_faces_outward() -> None:
    ports = resolve_ports(box_mesh(), end_ports(radius=8.0), Unit.MM)
    for port in ports:
        assert port.area == pytest.approx(np.pi * 0.008**2, rel=0.01)
        assert abs(port.normal[0]) == pytest.approx(1)
    assert ports[0].normal[0] == pytest.approx(-1)
    np.testing.assert_allclose(ports[0].center, [0, 0.015, 0.02], atol=1e-5)


def test_a_facet_and_the_box_round_it_cover_the_same_area() -> None:
    mesh = box_mesh()
    facet = next(k for k, f in enumerate(mesh.facets) if f.normal[0] < -0.5)
    by_facet = resolve_ports(
        mesh, _fluids({"facet": facet}, cold_outlets={"center": (40, 60, 20), "radius": 5}), Unit.MM
    )
    by_box = resolve_ports(mesh, shared_ends(), Unit.MM)
    assert by_facet[0].area == pytest.approx(0.06 * 0.04, rel=1e-9)
    assert by_box[0].area == pytest.approx(0.06 * 0.04, rel=1e-9)


def test_a_disk_at_an_edge_does_not_reach_round_it() -> None:
    ports = resolve_ports(box_mesh(), _fluids({"center": (0, 30, 2), "radius": 6}), Unit.MM)
    np.testing.assert_allclose(ports[0].samples[:, 0], 0, atol=1e-12)


def test_the_same_opening_of_both_fluids_is_shared() -> None:
    assert all(port.shared for port in resolve_ports(box_mesh(), shared_ends(), Unit.MM))
    assert not any(port.shared for port in resolve_ports(box_mesh(), end_ports(), Unit.MM))


def test_a_port_off_the_boundary_is_told_how_far() -> None:
    with pytest.raises(PortNotOnBoundary, match="12 mm away") as refused:
        resolve_ports(box_mesh(), _fluids({"center": (-20, 15, 20), "radius": 8}), Unit.MM)
    assert refused.value.measured["gap_m"] == pytest.approx(0.012, rel=1e-3)


def test_ports_that_overlap_are_refused() -> None:
    with pytest.raises(OverlappingPorts):
        resolve_ports(box_mesh(), _fluids({"center": (0, 40, 20), "radius": 8}), Unit.MM)


def test_a_facet_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InvalidSpec, match="6 planar facets"):
        resolve_ports(box_mesh(), _fluids({"facet": 99}), Unit.MM)


def test_lateral_distance_is_that_of_the_circle() -> None:
    port = resolve_ports(box_mesh(), end_ports(radius=8.0), Unit.MM)[0]
    points = np.array([[0.01, 0.015, 0.02], [0.01, 0.015 + 0.006, 0.02], [-0.02, 0.015, 0.03]])
    np.testing.assert_allclose(port.lateral(points), [0.008, 0.002, -0.002], atol=1e-12)


def test_a_tube_of_slivers_is_sampled_as_its_area_asks() -> None:
    # 2,000 of its triangles are as long as the tube and 3/1000 of it wide: at the longest edge's pitch in both
    # directions they alone would have 300 million samples.
    tube = trimesh.creation.cylinder(radius=0.5, height=1.0, sections=1000)
    mesh = DomainMesh(np.asarray(tube.vertices), np.asarray(tube.faces), Unit.M)
    lower, upper = ([{"facet": k}] for k in range(2))
    given = {"hot": {"inlets": lower, "outlets": upper}, "cold": {"inlets": upper, "outlets": lower}}
    (port, *_) = resolve_ports(mesh, FluidsSpec.model_validate(given), Unit.M)
    assert len(port.samples) < 2_000_000
    assert port.area == pytest.approx(np.pi / 4, rel=1e-4)
    assert np.linalg.norm(port.samples - port.center, axis=1).min() < 1 / SAMPLES_ACROSS


@pytest.mark.parametrize("shape", ["box", "slivers"])
def test_samples_of_some_triangles_are_those_of_all_that_lie_in_them(shape: str) -> None:
    if shape == "box":
        mesh = box_mesh()
    else:  # of which the long thin ones are cut into rows
        tube = trimesh.creation.cylinder(0.01, 0.1, sections=400)
        mesh = DomainMesh(np.asarray(tube.vertices), tube.faces.astype(np.int64), Unit.MM)
    wanted = np.random.default_rng(0).random(len(mesh.faces)) < 0.3
    points, owners, areas = boundary_samples(mesh)
    some = wanted[owners]
    for found, known in zip(boundary_samples(mesh, wanted), (points[some], owners[some], areas[some]), strict=True):
        np.testing.assert_array_equal(found, known)
