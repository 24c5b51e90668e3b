"""A budget of faces: kept where the wall's thickness allows, and said where not."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.body.body import Body, make_body
from dualms.body.walls import channel
from dualms.domain import Domain
from dualms.measure.printing import wall_samples
from dualms.surface import Surface, extract_surface
from tests.dualms.shapes import box_mesh, domain_of, gyroid, shared_ends

pytestmark = pytest.mark.slow
WALL, SHELL = 0.04, 0.05


@pytest.fixture(scope="module")
def given() -> tuple[Domain, Surface]:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(64, padding=4)
    return domain, extract_surface(domain, gyroid(grid, 0.5), grid, WALL / 2 + 2.5 * grid.spacing, SHELL, 0.0)


@pytest.fixture(scope="module")
def bodies(given: tuple[Domain, Surface]) -> dict[str, Body]:
    domain, surface = given
    free = make_body(domain, surface, WALL, SHELL)
    asked = int(0.95 * len(free.solid.faces))
    return {
        "free": free,
        "asked": make_body(domain, surface, WALL, SHELL, max_faces=asked),
        "least": make_body(domain, surface, WALL, SHELL, max_faces=1000),
    }


def test_a_budget_is_kept(bodies: dict[str, Body]) -> None:
    free, asked = (len(bodies[name].solid.faces) for name in ("free", "asked"))
    assert 0.5 * free < asked <= 0.95 * free


@pytest.mark.parametrize("name", ["free", "asked", "least"])
def test_the_wall_keeps_its_thickness_and_the_meshes_stay_sound(bodies: dict[str, Body], name: str) -> None:
    body = bodies[name]
    _, thickness = wall_samples(body, 0)
    low, high = np.quantile(thickness / body.wall_m, (0.01, 0.99))
    assert low > 0.97
    assert high < 1.03
    assert body.crossing == body.hot.crossing == body.cold.crossing == 0
    for mesh in (body.solid, body.hot.mesh, body.cold.mesh):
        assert mesh.is_closed
    filled = body.solid.volume + body.dropped_m3 + body.hot.mesh.volume + body.cold.mesh.volume
    assert filled == pytest.approx(body.outline_m3, rel=2e-5)
    assert body.solid.volume == pytest.approx(bodies["free"].solid.volume, rel=2e-3)


def test_a_budget_that_cannot_be_kept_goes_as_far_as_the_wall_allows(bodies: dict[str, Body]) -> None:
    assert 1000 < len(bodies["least"].solid.faces) <= len(bodies["asked"].solid.faces)


def test_sides_end_where_nobody_wants_them(given: tuple[Domain, Surface]) -> None:
    domain, surface = given
    reach = 2 * surface.grid.spacing
    for side in (channel(surface, WALL, reach, sign) for sign in (1, -1)):
        outside = -domain.signed_distance(side.mesh().vertices)
        assert reach < outside.max() < reach + 2.5 * surface.grid.spacing
