"""The preview draws fluids by the solid's faces: with the openings these are the whole of their boundaries."""

from __future__ import annotations

import pytest

from dualms.body.body import make_body
from dualms.pictures import openings
from dualms.surface import extract_surface
from tests.dualms.shapes import box_mesh, domain_of, halves, shared_ends

WALL = 0.02


@pytest.mark.parametrize("shell", [0.03, 0.0], ids=["shell", "bare"])
def test_the_solids_faces_and_the_openings_are_the_fluids_boundaries(shell: float) -> None:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(48, padding=4)
    surface = extract_surface(domain, halves(grid), grid, 0.07, shell)
    body = make_body(domain, surface, WALL, shell)
    for fluid, side, (opening, _) in zip((body.hot, body.cold), (1, -1), openings(body), strict=True):
        shown = body.solid.part(body.solid_side == side).area + opening.area
        assert shown == pytest.approx(fluid.mesh.area, rel=1e-5)
