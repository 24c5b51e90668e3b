from types import SimpleNamespace

import numpy as np
import pytest
from skimage.measure import marching_cubes, mesh_surface_area

from dualms.domain import Domain
from dualms.errors import EmptySurface
from dualms.field import topology
from dualms.field.minimal import level
from dualms.field.phase_field import solve_phase_field
from dualms.field.torus import Torus
from dualms.grid import Grid
from dualms.measure.curvature import away_from_boundary, mean_curvature
from dualms.progress import Silent


class Recorder:
    def __init__(self) -> None:
        self.fractions: list[float] = []

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        assert stage == "field"
        self.fractions.append(fraction)


def area(values: np.ndarray, spacing: float) -> float:
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    return float(mesh_surface_area(vertices * spacing, faces))


@pytest.mark.parametrize("minimality", [0.0, 0.5])
def test_two_parallel_lines_are_separated_by_the_middle_plane(
    unit_box: Domain, parallel_lines: SimpleNamespace, minimality: float
) -> None:
    progress = Recorder()
    field = solve_phase_field(unit_box, parallel_lines, 32, minimality, progress)
    grid = unit_box.grid(64)
    values = field.on(grid)
    x = grid.points()[:, 0].reshape(grid.shape)
    near = np.abs(x - 0.5) < 0.03
    if minimality > 0:
        # The start is half the difference of the distances, which is flatter off the skeletons; the flow steepens it.
        np.testing.assert_allclose(values[near], (0.5 - x)[near], atol=5e-3)
    assert np.array_equal(values[near] > 0, (x < 0.5)[near])
    assert progress.fractions == sorted(progress.fractions)
    assert progress.fractions[-1] == 1


def test_field_is_defined_beyond_the_wall(unit_box: Domain, parallel_lines: SimpleNamespace) -> None:
    field = solve_phase_field(unit_box, parallel_lines, 32, 0.5, Silent())
    samples = field.source.grid
    assert (samples.origin <= -0.06).all()
    assert (samples.origin + samples.spacing * (np.array(samples.shape) - 1) >= 1.06).all()


def test_schwarz_p_is_near_its_exact_area(unit_box: Domain, schwarz_p: SimpleNamespace) -> None:
    field = solve_phase_field(unit_box, schwarz_p, 48, 0.5, Silent())
    grid = unit_box.grid(96, padding=0)
    # Sampled at the cell's midpoints: scale the clipped area up to the whole cell's.
    values = field.on(grid)
    whole = area(values, grid.spacing) / (1 - grid.spacing) ** 2
    assert whole == pytest.approx(2.3451028840, rel=0.02)
    assert (np.diff(field.history.column("energy")) < 0).all(), "the flow lowers its energy"


def test_each_fluid_stays_one_piece_round_its_skeleton(unit_box: Domain, schwarz_p: SimpleNamespace) -> None:
    field = solve_phase_field(unit_box, schwarz_p, 32, 0.5, Silent())
    grid = unit_box.grid(64)
    inside, hot = unit_box.inside(grid), field.on(grid) > 0
    assert topology.component_counts(hot, inside) == (1, 1)
    for points, colour in ((schwarz_p.hot, True), (schwarz_p.cold, False)):
        at = tuple(grid.nearest(points).T)
        assert (hot[at] == colour)[inside[at]].all()


def test_same_input_gives_same_bytes(unit_box: Domain, schwarz_p: SimpleNamespace) -> None:
    a, b = (solve_phase_field(unit_box, schwarz_p, 24, 0.5, Silent()) for _ in range(2))
    assert a.source.values.tobytes() == b.source.values.tobytes()


def test_a_fluid_without_room_is_refused(unit_box: Domain) -> None:
    point = np.full((1, 3), 5.0)
    with pytest.raises(EmptySurface, match="cold"):
        solve_phase_field(unit_box, SimpleNamespace(hot=np.full((1, 3), 0.5), cold=point), 24, 0.5, Silent())


def test_minimal_end_brings_a_bent_surface_to_no_curvature(unit_box: Domain, schwarz_p: SimpleNamespace) -> None:
    figures = []
    for minimality in (0.0, 0.5, 0.75):
        field = solve_phase_field(unit_box, schwarz_p, 24, minimality, Silent())
        grid = unit_box.grid(48, padding=0)
        vertices, faces, _, _ = marching_cubes(field.on(grid), 0.0)
        faces = faces.astype(np.int64)
        h = mean_curvature(vertices * grid.spacing, faces)
        figures.append(np.sqrt(np.nanmean(h[away_from_boundary(vertices * grid.spacing, faces, 0.08)] ** 2)))
    equidistant, diffused, minimal = figures
    assert diffused < 0.5 * equidistant
    assert minimal < 0.6 * diffused
    assert set(field.history.column("phase")) == {0, 1, 2}


def test_the_minimal_ends_grid_resolves_the_gap_and_is_no_finer_than_it_pays() -> None:
    assert level(64, 0.0828, 0.168) == 106, "too coarse for the gap: raised"
    assert level(256, 0.0828, 0.168) == 106, "a finer mesh would be too large"
    assert level(48, 0.43, 1.0) == 48
    assert level(256, 0.2, 1.0) == 64
    assert level(256, 0.43, 1.0) == 56, "a finer grid gains nothing"


@pytest.mark.parametrize(
    ("cell", "exact"), [("P", 2.3451028840), ("D", 3.8377847135)], ids=["two cubic nets", "two diamond nets"]
)
def test_periodic_nets_are_separated_by_their_minimal_surface(cell: str, exact: float) -> None:
    side = np.linspace(0, 1, 129)[:-1, None]
    if cell == "P":
        hot = np.concatenate([side * axis for axis in np.eye(3)])
    else:
        nodes = np.array([(0, 0, 0), (0, 2, 2), (2, 0, 2), (2, 2, 0)]) / 4
        bonds = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / 4
        hot = np.concatenate([node + side * bond for node in nodes for bond in bonds])
    nets = SimpleNamespace(hot=np.mod(hot, 1), cold=np.mod(hot + 0.5, 1))
    field = solve_phase_field(Torus(), nets, 40, 1.0, Silent())
    grid = Grid(np.zeros(3), 1 / 96, (97,) * 3)
    values = field.on(grid)
    assert area(values, grid.spacing) == pytest.approx(exact, rel=2e-3)
    for axis in range(3):
        low, high = np.take(values, 0, axis), np.take(values, -1, axis)
        np.testing.assert_allclose(low, high, atol=2e-5)
