"""Guidance: closed forms, no sense of direction, robustness."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.flow import FlowField, even_flow, flow_field, path_lines, potential
from dualms.spec import DirectionFlow, FluidsSpec, NoFlow, PathFlow, PotentialFlow
from tests.dualms.shapes import box_mesh, domain_of, end_ports, shared_ends

SIZE = (80.0, 30.0, 30.0)


def _field(fluids: FluidsSpec, **spec: object) -> FlowField:
    flow = flow_field(domain_of(box_mesh(SIZE), fluids), PotentialFlow(), 1e-3)
    assert flow is not None
    return flow


def test_potential_between_opposite_faces_is_linear() -> None:
    inside = np.zeros((22, 8, 7), dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = True
    voxels = np.argwhere(inside)
    solution, velocity = potential(inside, voxels[voxels[:, 0] == 1], voxels[voxels[:, 0] == 20])
    exact = 1 - (voxels[:, 0] - 0.5) / 20
    np.testing.assert_allclose(solution, exact, atol=1e-5)
    np.testing.assert_allclose(velocity, np.broadcast_to([1 / 20, 0, 0], velocity.shape), atol=1e-5)


def test_potential_of_a_quarter_ring_falls_linearly_with_the_angle() -> None:
    cells = 40
    x, y = np.meshgrid(np.arange(cells) + 0.5, np.arange(cells) + 0.5, indexing="ij")
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    flat = (radius > 15) & (radius < 35)
    inside = np.repeat(flat[:, :, None], 3, axis=2)
    voxels = np.argwhere(inside)
    solution, _ = potential(inside, voxels[voxels[:, 1] == 0], voxels[voxels[:, 0] == 0])
    exact = 1 - angle[tuple(voxels[:, :2].T)] / (np.pi / 2)
    assert np.abs(solution - exact).max() < 0.03  # stair-stepped walls, 20 voxels across


def test_counter_flow_adds_up_instead_of_cancelling() -> None:
    flow = _field(shared_ends(SIZE))
    points = flow.grid.points(flow.inside)
    np.testing.assert_allclose(np.abs(flow.lines(points)[:, 0]), 1.0, atol=1e-4)
    assert flow.strength(points).min() > 0.9


def test_dedicated_ports_give_lines_along_the_box() -> None:
    flow = _field(end_ports(SIZE, radius=5.0))
    middle = np.array([[0.5, y, 0.19] for y in (0.1, 0.19, 0.28)])
    assert (np.abs(flow.lines(middle)[:, 0]) > 0.95).all()


def test_several_inlets_and_a_thin_neck_give_finite_unit_lines() -> None:
    document = end_ports(SIZE, radius=5.0).model_dump()
    document["hot"]["inlets"] = [*document["hot"]["inlets"], {"center": (40.0, 30.0, 15.0), "radius": 4.0}]
    flow = _field(FluidsSpec.model_validate(document))
    lines = flow.lines(flow.grid.points(flow.inside))
    np.testing.assert_allclose(np.linalg.norm(lines, axis=1), 1.0, atol=1e-9)
    inside = np.zeros((30, 12, 12), dtype=bool)
    inside[1:14, 1:-1, 1:-1] = inside[16:29, 1:-1, 1:-1] = True
    inside[14:16, 6, 6] = True
    voxels = np.argwhere(inside)
    _, velocity = potential(inside, voxels[voxels[:, 0] == 1], voxels[voxels[:, 0] == 28])
    through = [np.sum(velocity[voxels[:, 0] == x, 0]) for x in (3, 15, 25)]
    np.testing.assert_allclose(through, through[0], rtol=1e-4)


def test_direction_is_the_same_everywhere_and_of_any_length() -> None:
    domain = domain_of(box_mesh(SIZE), end_ports(SIZE, radius=5.0))
    flow = flow_field(domain, DirectionFlow(kind="direction", vector=(0.0, 3.0, -3.0)), 1e-3)
    assert flow is not None
    lines = flow.lines(flow.grid.points(flow.inside)[::50])
    np.testing.assert_allclose(np.abs(lines @ [0, np.sqrt(0.5), -np.sqrt(0.5)]), 1.0, atol=1e-6)


def test_path_is_read_in_the_units_of_the_specification() -> None:
    domain = domain_of(box_mesh(SIZE), end_ports(SIZE, radius=5.0))
    corner = PathFlow(kind="path", points=((0, 15, 15), (40, 15, 15), (40, 30, 15)))
    flow = flow_field(domain, corner, 1e-3)
    assert flow is not None
    lines = np.abs(flow.lines(np.array([[10, 10, 15], [45, 28, 15]]) / 80))
    np.testing.assert_allclose(lines, [[1, 0, 0], [0, 1, 0]], atol=1e-6)


def test_path_lines_follow_the_nearest_segment_on_a_circle() -> None:
    angle = np.linspace(0, 2 * np.pi, 400)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points = np.random.default_rng(0).normal(size=(200, 3))
    lines = path_lines(circle, points, 0.01)
    radial = points[:, :2] / np.linalg.norm(points[:, :2], axis=1)[:, None]
    assert np.abs((lines[:, :2] * radial).sum(axis=1)).max() < 0.02


def test_no_guidance_is_none() -> None:
    assert flow_field(domain_of(box_mesh(SIZE), end_ports(SIZE, radius=5.0)), NoFlow(kind="none")) is None


def test_flow_field_refuses_arrays_that_do_not_fit() -> None:
    flow = _field(shared_ends(SIZE))
    with pytest.raises(ValueError, match="six tensor components"):
        FlowField(flow.grid, flow.inside, flow.tensor[..., :3])


def test_even_flow_in_a_ring_falls_as_the_closed_form() -> None:
    # Between two radial faces the gradient is 1/(r·angle), so the flow that minimises ∫|v|^s has |v| ~ r^(-1/(s-1)).
    cells = 30
    x, y = np.meshgrid(np.arange(cells) + 0.5, np.arange(cells) + 0.5, indexing="ij")
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    inside = np.repeat(((radius > 8) & (radius < 28))[:, :, None], 2, axis=2)
    voxels = np.argwhere(inside)
    velocity = even_flow(inside, voxels[voxels[:, 1] == 0], voxels[voxels[:, 0] == 0], 4.0)
    at = radius[tuple(voxels[:, :2].T)]
    middle = (np.abs(angle[tuple(voxels[:, :2].T)] - np.pi / 4) < 0.5) & (at > 10) & (at < 26)
    slope = np.polyfit(np.log(at[middle]), np.log(np.linalg.norm(velocity, axis=1)[middle]), 1)[0]
    assert slope == pytest.approx(-1 / 3, abs=0.04)


def test_spread_fills_the_sections_more_evenly() -> None:
    inside = np.zeros((26, 18, 12), dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = True
    voxels = np.argwhere(inside)
    corner = (voxels[:, 1] < 5) & (voxels[:, 2] < 5)
    inlet, outlet = voxels[corner & (voxels[:, 0] == 1)], voxels[corner & (voxels[:, 0] == 24)]
    uneven = []
    for exponent in (2.0, 4.0, 8.0):
        along = even_flow(inside, inlet, outlet, exponent)[voxels[:, 0] == 13, 0]
        uneven.append(along.std() / along.mean())
    assert uneven[0] > 1.5 * uneven[1] > 1.5 * uneven[2]
