"""Graded walls: what is asked is interpolated as said, and measured on the body."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from dualms.body.body import make_body
from dualms.body.thickness import GradedWall, thickness_at
from dualms.body.walls import half_on_grid, wall_share
from dualms.measure.printing import wall_samples
from dualms.spec import Unit, WallGraded
from dualms.surface import extract_surface
from tests.dualms.shapes import box_mesh, domain_of, gyroid, shared_ends

ALONG = WallGraded.model_validate({"graded": {"direction": (2, 0, 0), "stations": [(10, 0.8), (70, 2.0)]}})


def test_stations_are_joined_by_lines_and_go_on_level() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    wall = GradedWall.of(ALONG, Unit.MM, domain)
    points = np.array([[x, 0.3, 0.2] for x in (0.0, 10 / 80, 40 / 80, 70 / 80, 1.0)])
    np.testing.assert_allclose(80 * wall.at(points), [0.8, 0.8, 1.4, 2.0, 2.0], rtol=1e-12)


def test_points_are_met_and_never_exceeded() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    given = {"points": [((0, 0, 0), 0.5), ((80, 60, 40), 1.5), ((40, 30, 20), 0.7)]}
    wall = GradedWall.of(WallGraded.model_validate({"graded": given}), Unit.MM, domain)
    at = np.array([point for point, _ in given["points"]]) / 80
    np.testing.assert_allclose(80 * wall.at(at), [0.5, 1.5, 0.7], rtol=1e-6)
    found = 80 * wall.at(np.random.default_rng(0).uniform(-1, 2, (500, 3)))
    assert found.min() >= 0.5
    assert found.max() <= 1.5


def test_the_grading_does_not_depend_on_where_the_part_lies() -> None:
    mesh = box_mesh()
    moved = type(mesh)(mesh.vertices_m + np.array([0.5, 0.2, -0.1]), mesh.faces, mesh.units)
    ports = {"box": [(500, 200, -100), (500, 260, -60)]}, {"box": [(580, 200, -100), (580, 260, -60)]}
    fluids = {n: {"inlets": [ports[0]], "outlets": [ports[1]]} for n in ("hot", "cold")}
    domain = domain_of(moved, type(shared_ends()).model_validate(fluids))
    spec = WallGraded.model_validate({"graded": {"direction": (1, 0, 0), "stations": [(510, 0.8), (570, 2.0)]}})
    assert 80 * GradedWall.of(spec, Unit.MM, domain).at(np.array([[0.5, 0, 0]]))[0] == pytest.approx(1.4)


@pytest.mark.slow
def test_the_body_has_the_graded_thickness_by_true_distance() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    wall = GradedWall.of(ALONG, Unit.MM, domain)
    grid = domain.grid(128, padding=4)
    surface = extract_surface(domain, gyroid(grid, 0.5), grid, wall.most / 2 + 2.5 * grid.spacing, 0.02)
    body = make_body(domain, surface, wall, 0.02)
    points, thickness = wall_samples(body, seed=0)
    over = thickness / (0.08 * wall.at(points / 0.08))
    low, high = np.quantile(over, (0.01, 0.99))
    assert low > 0.97
    assert high < 1.03
    assert thickness.min() < 0.00095
    assert thickness.max() > 0.0018
    assert body.leak_m3 == 0


def test_the_share_of_a_graded_plane_is_the_mean_thickness() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(64, padding=4)
    plane = (0.25 - grid.points()[:, 2]).reshape(grid.shape).astype(np.float32)
    surface = extract_surface(domain, plane, grid, 0.08)
    wall = GradedWall.of(ALONG, Unit.MM, domain)
    mean = thickness_at(wall, np.stack([(np.arange(400) + 0.5) / 400, *np.zeros((2, 400))], axis=1)).mean()
    assert wall_share(surface, half_on_grid(surface, wall)) == pytest.approx(mean / 0.5, rel=0.01)


@pytest.mark.parametrize(
    "graded",
    [
        {"direction": (0, 0, 0), "stations": [(0, 1), (1, 2)]},
        {"direction": (1, 0, 0), "stations": [(5, 1), (1, 2)]},
        {"direction": (1, 0, 0), "stations": [(0, -1), (1, 2)]},
        {"points": [((0, 0, 0), 1), ((0, 0, 0), 2)]},
    ],
)
def test_nonsense_is_refused(graded: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        WallGraded.model_validate({"graded": graded})
