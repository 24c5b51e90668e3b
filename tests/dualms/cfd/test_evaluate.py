import json
from dataclasses import replace

import numpy as np
import pytest

from dualms.cfd.baselines import PowerLaw, cell_of_solid_fraction, exact_distance, tpms_distance
from dualms.cfd.channels import Openings, VoxelExchanger, solid_share
from dualms.cfd.evaluate import evaluate
from dualms.cfd.exchanger import solve_exchanger
from dualms.cfd.limits import shortest_length, straight_passage
from dualms.cfd.openfoam import find_openfoam
from dualms.errors import EvaluationUnavailable
from dualms.grid import Grid
from dualms.progress import Cancelled, Silent
from dualms.spec import EvaluationSpec
from dualms.surface import Values
from dualms.tpms import tpms_field
from tests.dualms.cfd.conftest import BOX, box_design, gyroid_in_box, slow_fluid, two_ducts

QUICK = EvaluationSpec(resolution=40, iterations=150)
CELL, WALL = 0.25, 0.02


def turned(exchanger: VoxelExchanger) -> VoxelExchanger:
    """The exchanger mirrored along x, then with its axes rotated: x to y, y to z, z to x."""

    def array(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.transpose(values[::-1], (2, 0, 1)))

    def openings(old: Openings) -> Openings:
        def faces(given: np.ndarray) -> np.ndarray:
            x, y, z, d = given.T
            x = exchanger.labels.shape[0] - 1 - x
            d = np.array([1, 0, 2, 3, 4, 5])[d]
            d = np.array([2, 3, 4, 5, 0, 1])[d]
            return np.column_stack([z, x, y, d])

        normals = (old.inlet_normals * [-1, 1, 1])[:, [2, 0, 1]]
        new = faces(old.inlet)
        order = np.lexsort(new.T[::-1])
        out = faces(old.outlet)
        return Openings(new[order], out[np.lexsort(out.T[::-1])], normals[order])

    return replace(
        exchanger,
        labels=array(exchanger.labels),
        distance_m=array(exchanger.distance_m),
        hot=openings(exchanger.hot),
        cold=openings(exchanger.cold),
    )


@pytest.mark.cfd
def test_mirror_and_rotation_change_nothing_and_balances_close(foam, tmp_path) -> None:
    _, fluids = box_design(BOX, True)
    exchanger = gyroid_in_box(WALL)
    said: list[float] = []
    first = solve_exchanger(foam, exchanger, fluids, QUICK, tmp_path / "a", lambda f, note: said.append(f)).figures
    second = solve_exchanger(foam, turned(exchanger), fluids, QUICK, tmp_path / "b").figures
    for one, other in ((first.hot, second.hot), (first.cold, second.cold)):
        assert other.pressure_drop_pa == pytest.approx(one.pressure_drop_pa, rel=0.01)
        assert other.film_conductance_w_k == pytest.approx(one.film_conductance_w_k, rel=0.01)
        assert other.cells == one.cells
        assert abs(one.mass_imbalance) < 1e-4
        assert abs(one.energy_imbalance) < 5e-3
        assert one.state == "steady"
    assert second.ua_w_k == pytest.approx(first.ua_w_k, rel=0.01)
    assert second.solid_fraction == pytest.approx(first.solid_fraction)
    assert said == sorted(said)
    assert said[-1] == 1.0
    # Heat cannot pass better than through both films in series.
    film = 1 / (1 / first.hot.film_conductance_w_k + 1 / first.cold.film_conductance_w_k)
    assert 0.3 * film < first.ua_w_k < 1.1 * film


@pytest.mark.cfd
def test_a_gyroid_against_itself_is_a_draw(foam, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("dualms.cfd.pictures.SIZE", (240, 160))
    domain, fluids = box_design(BOX, True)
    spec = EvaluationSpec(resolution=40, iterations=100, baselines=("gyroid",), match="ua", keep_case=True)
    grid = domain.grid(64, 4)
    picture = tmp_path / "evaluation.png"
    found = evaluate(
        domain, tpms_field("gyroid", grid, CELL), grid, WALL, fluids, spec, Silent(), tmp_path / "work", 0.0, picture
    )
    assert found.problem is None
    assert found.design is not None
    by = {c.match: c for c in found.comparisons}
    assert by["solid-fraction"].pressure_ratio == pytest.approx(1, abs=0.05)
    assert by["ua"].pressure_ratio == pytest.approx(1, abs=0.05)
    assert by["ua"].cell_m == pytest.approx(CELL * domain.scale_m, rel=0.03)
    assert 0 < found.floor["hot"].pressure_drop_pa < found.design.hot.pressure_drop_pa
    assert json.loads(json.dumps(found.to_json()))["mode"] == "quick: for ranking"
    assert picture.stat().st_size > 10_000
    others = [p for p in (tmp_path / "work").rglob("*") if p.is_file() and "design" not in p.parts]
    assert {p.name for p in others} == {"log.simpleFoam"}
    assert (tmp_path / "work" / "design" / "hot" / "log.simpleFoam").is_file()


@pytest.mark.cfd
def test_a_blocked_design_is_a_stated_problem(foam, tmp_path) -> None:
    domain, fluids = box_design(BOX, True)
    grid = domain.grid(40, 4)
    across = (0.5 - grid.points()[:, 0]).reshape(grid.shape)
    picture = tmp_path / "evaluation.png"
    found = evaluate(domain, across, grid, WALL, fluids, QUICK, Silent(), tmp_path / "work", 0.0, picture)
    assert picture.stat().st_size > 1000
    assert found.design is None
    assert found.problem is not None
    assert found.problem.code == "channel-blocked"


@pytest.mark.cfd
def test_cancelling_an_evaluation_stops_both_solvers(foam, tmp_path) -> None:
    domain, fluids = box_design(BOX, True)
    grid = domain.grid(40, 4)

    class Impatient:
        def report(self, stage: str, fraction: float, note: str = "") -> None:
            if "iteration 3" in note:
                raise Cancelled

    with pytest.raises(Cancelled):
        evaluate(domain, tpms_field("gyroid", grid, CELL), grid, WALL, fluids, QUICK, Impatient(), tmp_path / "work")
    left = {str(p.relative_to(tmp_path / "work")) for p in (tmp_path / "work").rglob("*") if p.is_file()}
    assert left == {"design/hot/log.simpleFoam", "design/cold/log.simpleFoam"}


def test_without_openfoam_an_evaluation_is_refused_with_advice(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    find_openfoam.cache_clear()
    domain, fluids = box_design(BOX, True)
    grid = domain.grid(24, 4)
    with pytest.raises(EvaluationUnavailable, match="not found") as caught:
        evaluate(domain, tpms_field("gyroid", grid, CELL), grid, WALL, fluids, QUICK, Silent(), tmp_path / "work")
    find_openfoam.cache_clear()
    assert "apt-get install openfoam" in caught.value.advice


def test_distances_do_not_depend_on_the_grid_that_the_field_came_on() -> None:
    domain, _ = box_design(BOX, True)
    target = domain.grid(40, 2)

    def on(grid: Grid) -> Values:
        return exact_distance(tpms_field("gyroid", grid, CELL), grid, target, WALL)

    coarse, fine = on(domain.grid(64, 3)), on(domain.grid(128, 4))
    inside = domain.inside(target)
    assert np.abs(coarse - fine)[inside].max() < 0.1 * target.spacing
    assert np.abs(on(target) - fine)[inside].max() < 0.25 * target.spacing


def test_cells_are_found_for_a_solid_fraction() -> None:
    domain, _ = box_design(BOX, True)
    grid = domain.grid(48, 2)
    cell = cell_of_solid_fraction(domain, "p", grid, WALL, 0.2)
    assert cell == pytest.approx(WALL * 2.35 / 0.2, rel=0.1)
    fine = domain.grid(80, 2)
    distance = tpms_distance("p", cell, fine, WALL)
    assert solid_share(distance[domain.inside(fine)], WALL, fine.spacing) == pytest.approx(0.2, rel=0.05)


def test_power_laws_return_their_points_and_extend_them() -> None:
    cells = (0.2, 0.25, 0.3)
    law = PowerLaw(cells, tuple(3 * c**-0.9 for c in cells), tuple(2 * c**-1.5 for c in cells))
    assert law.cell_at(3 * 0.22**-0.9) == pytest.approx(0.22)
    assert law.pressure_at(3 * 0.4**-0.9) == pytest.approx(2 * 0.4**-1.5)
    one = PowerLaw((0.2,), (5.0,), (100.0,))
    assert one.pressure_at(5.0) == pytest.approx(100)
    assert one.cell_at(6.0) < 0.2
    assert one.pressure_at(6.0) > 100


def test_the_straight_passage_is_poiseuilles_tube() -> None:
    exchanger = two_ducts(8, 8, 40, side_walls=True)
    assert shortest_length(exchanger, 1) == pytest.approx(40 * exchanger.spacing_m)
    fluid = slow_fluid(10.0, 100.0, 1e-4)
    radius, length = 0.005, 40 * exchanger.spacing_m
    found = straight_passage(exchanger, 1, np.pi * radius**2 * length, 2 * radius, fluid)
    flow = fluid.mass_flow_kg_s / fluid.density_kg_m3
    assert found.pressure_drop_pa == pytest.approx(
        8 * fluid.viscosity_pa_s * length * flow / (np.pi * radius**4), rel=1e-6
    )
    assert found.film_conductance_w_k > 3.66 * np.pi * fluid.conductivity_w_m_k * length
