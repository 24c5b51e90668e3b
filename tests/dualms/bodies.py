"""Small bodies for tests of what is written of them, in metres."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import trimesh

from dualms.body.body import Body, make_body
from dualms.domain import Domain
from dualms.pipeline import run_step
from dualms.progress import Silent
from dualms.spec import Spec, Unit
from dualms.steps import steps_of
from dualms.surface import Surface, extract_surface
from tests.dualms.shapes import box_mesh, domain_of, end_ports, gyroid, halves, shared_ends

WALL, SHELL = 0.02, 0.03  # of the box's 80 mm


@lru_cache(maxsize=1)
def gyroid_body() -> tuple[Domain, Surface, Body]:
    """A gyroid with shared ends in the box of 80 x 60 x 40 mm, exact in single precision in millimetres."""
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(64, padding=4)
    surface = extract_surface(domain, gyroid(grid, 0.5), grid, WALL / 2 + 2.5 * grid.spacing, SHELL)
    return domain, surface, make_body(domain, surface, WALL, SHELL, unit_m=1e-3)


@lru_cache(maxsize=4)
def flat_body(units: Unit) -> Body:
    """The same box halved by a plane, with four disk ports, exact in single precision in ``units``."""
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(40, padding=4)
    surface = extract_surface(domain, halves(grid), grid, WALL / 2 + 2.5 * grid.spacing, SHELL)
    return make_body(domain, surface, WALL, SHELL, unit_m=units.metres)


def build_box(folder: Path, spec: Spec) -> None:
    """Run every step of a specification for the box, written as an STL in millimetres, in a folder."""
    box = box_mesh()
    shape = trimesh.Trimesh(box.vertices_m * 1e3, box.faces, process=False)
    (folder / "box.stl").write_bytes(trimesh.exchange.stl.export_stl(shape))
    for step in steps_of(spec):
        run_step(step, folder, folder / "box.stl", spec, Silent())
