"""The field's file as other programs read it: in the model's unit, the same values, the true gradient."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dualms.domain import Domain
from dualms.field.field import Field, History, load_field, save_field
from dualms.field.network import Network
from dualms.field.samples import GridSamples
from dualms.field_file import read, write
from dualms.grid import Grid
from dualms.mesh import DomainMesh
from dualms.spec import Unit
from tests.dualms.shapes import box_mesh

OFFSET_MM = np.array([100.0, -20.0, 7.0])
CENTRE_MM, RADIUS_MM = OFFSET_MM + np.array([40.0, 30.0, 20.0]), 15.0


def _domain() -> Domain:
    box = box_mesh()
    return Domain.from_mesh(DomainMesh(box.vertices_m + 1e-3 * OFFSET_MM, box.faces, Unit.MM), ())


def _field(source: GridSamples | Network) -> Field:
    return Field(source, "phase-field", History(("iteration",), np.zeros((0, 1))), "cpu")


def _sphere(domain: Domain) -> Field:
    """Distance to a sphere of 15 mm about the box's middle, positive inside, as a solver would give it."""
    grid = domain.grid(80)
    centre = (1e-3 * CENTRE_MM - domain.offset_m) / domain.scale_m
    distance = 1e-3 * RADIUS_MM / domain.scale_m - np.linalg.norm(grid.points() - centre, axis=1)
    return _field(GridSamples(grid, distance.reshape(grid.shape).astype(np.float32)))


def _network(seed: int = 0) -> Network:
    draw = np.random.default_rng(seed)

    def floats(*shape: int) -> np.ndarray:
        return draw.normal(size=shape).astype(np.float32)

    return Network(
        floats(3, 8), ((floats(16, 12), floats(12)), (floats(12, 12), floats(12)), (floats(12, 1), floats(1)))
    )


def test_the_zero_level_lies_where_the_model_has_it(tmp_path: Path) -> None:
    domain = _domain()
    write(_sphere(domain), domain, Unit.MM, tmp_path / "field.safetensors")
    field = read(tmp_path / "field.safetensors")
    assert field.units == Unit.MM
    assert field.voxel == pytest.approx(1.0)
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    on = CENTRE_MM + RADIUS_MM * directions
    # Cubic splines through a distance: fourth order in voxel over radius.
    assert np.abs(field.scale * field.value(on)).max() < 1e-3 * field.voxel
    assert (field.value(on + directions) < 0).all()
    assert (field.value(on - directions) > 0).all()
    # A distance over the scale falls by 1 over the scale a unit of length.
    assert field.scale * field.gradient(on) == pytest.approx(-directions, abs=2e-3)


def test_values_at_voxels_are_those_that_the_surface_is_taken_from(tmp_path: Path) -> None:
    domain = _domain()
    made = _sphere(domain)
    write(made, domain, Unit.MM, tmp_path / "field.safetensors")
    fine = domain.grid(97)
    values = read(tmp_path / "field.safetensors").value(1e3 * (domain.offset_m + domain.scale_m * fine.points()))
    assert values.reshape(fine.shape) == pytest.approx(made.on(fine), abs=2e-6)  # single precision there


@pytest.mark.parametrize("units", list(Unit))
def test_every_unit_gives_the_same_field(units: Unit, tmp_path: Path) -> None:
    domain = _domain()
    write(_sphere(domain), domain, units, tmp_path / "field.safetensors")
    field = read(tmp_path / "field.safetensors")
    points_m = 1e-3 * (CENTRE_MM + np.array([[3.0, 4, 0], [9, 12, 0], [0, 12, 16]]))
    assert field.value(points_m / units.metres) == pytest.approx(np.array([10.0, 0, -5]) / 80, abs=1e-4)


@pytest.mark.parametrize("kind", ["grid", "network"])
def test_the_gradient_is_that_of_the_value(kind: str, tmp_path: Path) -> None:
    domain = _domain()
    write(_field(_network()) if kind == "network" else _sphere(domain), domain, Unit.MM, tmp_path / "f")
    field = read(tmp_path / "f")
    points = OFFSET_MM + np.random.default_rng(1).uniform(2, 38, (200, 3))
    step = 0.02  # mm: single precision limits it from below
    steps = step * np.eye(3)
    slopes = np.stack([field.value(points + s) - field.value(points - s) for s in steps], axis=1) / (2 * step)
    assert field.gradient(points) == pytest.approx(slopes, abs=2e-3 * np.abs(slopes).max())


def test_beyond_the_samples_the_field_is_constant(tmp_path: Path) -> None:
    domain = _domain()
    write(_sphere(domain), domain, Unit.MM, tmp_path / "f")
    field = read(tmp_path / "f")
    far = OFFSET_MM + np.array([[500.0, 30, 20], [600, 30, 20]])
    assert field.value(far)[0] == field.value(far)[1]
    assert (field.gradient(far)[:, 0] == 0).all()


def test_the_steps_read_the_same_file(tmp_path: Path) -> None:
    domain = _domain()
    made = _field(_network())
    write(made, domain, Unit.MM, tmp_path / "f")
    grid = Grid.around(np.zeros(3), np.ones(3), 8)
    assert (load_field(tmp_path / "f").on(grid) == made.on(grid)).all()


def test_a_file_without_the_models_frame_is_refused(tmp_path: Path) -> None:
    save_field(_sphere(_domain()), tmp_path / "bare")
    (tmp_path / "text").write_text("no field")
    for name in ("bare", "text"):
        with pytest.raises(ValueError, match=f"{name} is not a field"):
            read(tmp_path / name)


@pytest.mark.parametrize("points", [[1.0, 2, 3], [[1.0, 2]], [[np.nan, 0, 0]]])
def test_points_must_be_points(points: list[object], tmp_path: Path) -> None:
    domain = _domain()
    write(_sphere(domain), domain, Unit.MM, tmp_path / "f")
    with pytest.raises(ValueError, match="points must be finite"):
        read(tmp_path / "f").value(points)
