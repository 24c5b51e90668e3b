"""Sections along the flow: where they lie, and areas of known shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dualms.body.body import Body, make_body
from dualms.domain import Domain
from dualms.maps import maps
from dualms.measure.curvature import mean_curvature
from dualms.sections import FIRST, section, sections_picture, stations
from dualms.surface import Surface, extract_surface
from tests.dualms.shapes import box_mesh, domain_of, halves, shared_ends

WALL = 0.02
SHELL = 0.03


@pytest.fixture(scope="module")
def ducts() -> tuple[Domain, Surface, Body]:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(48, padding=4)
    surface = extract_surface(domain, halves(grid), grid, 0.07, SHELL)
    return domain, surface, make_body(domain, surface, WALL, SHELL)


def test_stations_stand_across_a_straight_flow_at_equal_steps(ducts: tuple[Domain, Surface, Body]) -> None:
    found = stations(ducts[0], 5)
    for station, share in zip(found, np.linspace(FIRST, 1 - FIRST, 5), strict=True):
        assert station.share == pytest.approx(share)
        assert station.point[0] == pytest.approx(share, abs=0.03)
        np.testing.assert_allclose(station.point[1:], [0.375, 0.25], atol=0.02)
        np.testing.assert_allclose(station.direction, [1, 0, 0], atol=0.05)


def test_a_section_of_plain_ducts_has_their_areas(ducts: tuple[Domain, Surface, Body]) -> None:
    body = ducts[2]
    cut = section(body, np.array([0.041, 0.03, 0.02]), np.array([1.0, 0.0, 0.0]))
    duct = (0.03 - WALL / 2 * 0.08 - SHELL * 0.08) * (0.04 - 2 * SHELL * 0.08)
    assert cut.areas["hot"] == pytest.approx(duct, rel=0.01)
    assert cut.areas["cold"] == pytest.approx(duct, rel=0.01)
    assert sum(cut.areas.values()) == pytest.approx(0.06 * 0.04, rel=1e-6)
    sides = sorted(np.ptp(cut.outlines["hot"][0], axis=0))
    assert sides == pytest.approx(sorted([0.03 - WALL / 2 * 0.08 - SHELL * 0.08, 0.04 - 2 * SHELL * 0.08]), rel=0.01)


def test_an_oblique_section_is_longer_by_the_slant(ducts: tuple[Domain, Surface, Body]) -> None:
    slant = np.radians(30)
    cut = section(ducts[2], np.array([0.04, 0.03, 0.02]), np.array([np.cos(slant), 0, np.sin(slant)]))
    assert sum(cut.areas.values()) == pytest.approx(0.06 * 0.04 / np.cos(slant), rel=1e-6)


def test_pictures_show_both_fluids_and_the_maps(ducts: tuple[Domain, Surface, Body], tmp_path: Path) -> None:
    domain, surface, body = ducts
    sections_picture(domain, body, tmp_path / "sections.png", 2)
    maps(surface.mesh, mean_curvature(surface.mesh.vertices, surface.mesh.faces), body, tmp_path / "maps.png", 160)
    pixels = np.asarray(Image.open(tmp_path / "sections.png").convert("RGB")).reshape(-1, 3).astype(int)
    red, blue = ((pixels[:, a] > pixels[:, b] + 80).mean() for a, b in ((0, 2), (2, 0)))
    assert red == pytest.approx(blue, rel=0.05)
    assert red > 0.02
    drawn = np.asarray(Image.open(tmp_path / "maps.png").convert("L")) < 200
    left, right = np.array_split(drawn, 2, axis=1)
    assert left.mean() > 0.02
    assert right.mean() > 0.02
