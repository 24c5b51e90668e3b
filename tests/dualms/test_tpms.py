import numpy as np
import pytest

from dualms.grid import Grid
from dualms.surface import level_set
from dualms.tpms import AREA, KINDS, Kind, tpms_field

MINIMAL = {"gyroid": 3.0914437988, "p": 2.3451028840, "d": 3.8377847135, "iwp": 3.4641}
"""Areas of the minimal surfaces in a cubic cell of edge 1 (elliptic integrals)."""


def area_in_one_cell(kind: Kind, resolution: int) -> float:
    """Marching cubes over a padded block; the triangles whose middles lie in one cell."""
    grid = Grid.around(np.full(3, -0.1), np.full(3, 1.1), resolution)
    mesh = level_set(tpms_field(kind, grid, 1.0, np.full(3, 0.013)), grid)
    inside = ((mesh.centroids > 0) & (mesh.centroids < 1)).all(axis=1)
    return float(mesh.areas[inside].sum())


@pytest.mark.parametrize("kind", KINDS)
def test_area_of_a_cell_is_the_tabulated_one_and_near_the_minimal_surface(kind: Kind) -> None:
    area = area_in_one_cell(kind, 64)
    assert area == pytest.approx(AREA[kind], rel=0.003)
    assert 0.999 * MINIMAL[kind] < AREA[kind] < 1.03 * MINIMAL[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_fields_are_periodic_and_scale_with_the_cell(kind: Kind) -> None:
    grid = Grid(np.array([0.11, 0.23, 0.31]), 0.05, (5, 6, 7))
    moved = Grid(grid.origin + 0.4 * np.array([1, -2, 3]), 0.05, grid.shape)
    scaled = Grid(2 * grid.origin, 0.1, grid.shape)
    values = tpms_field(kind, grid, 0.4)
    assert np.allclose(values, tpms_field(kind, moved, 0.4), atol=1e-5)
    assert np.allclose(values, tpms_field(kind, scaled, 0.8), atol=1e-5)
    assert values.dtype == np.float32


@pytest.mark.parametrize("kind", ["gyroid", "p", "d"])
def test_balanced_surfaces_halve_the_cell(kind: Kind) -> None:
    grid = Grid(np.full(3, 1 / 64), 1 / 32, (32, 32, 32))
    assert float((tpms_field(kind, grid, 1.0) > 0).mean()) == pytest.approx(0.5, abs=0.01)


def test_a_cell_without_size_is_refused() -> None:
    with pytest.raises(ValueError, match="positive edge"):
        tpms_field("gyroid", Grid(np.zeros(3), 0.1, (2, 2, 2)), 0.0)
