from types import SimpleNamespace

import numpy as np
import pytest
from skimage.measure import marching_cubes, mesh_surface_area

from dualms.domain import Domain
from dualms.errors import EmptySurface
from dualms.field import topology
from dualms.field.minimal import levels
from dualms.field.phase_field import solve_phase_field
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
        field = solve_phase_field(unit_box, schwarz_p, 32, minimality, Silent())
        grid = unit_box.grid(64, padding=0)
        vertices, faces, _, _ = marching_cubes(field.on(grid), 0.0)
        faces = faces.astype(np.int64)
        h = mean_curvature(vertices * grid.spacing, faces)
        figures.append(np.sqrt(np.nanmean(h[away_from_boundary(vertices * grid.spacing, faces, 0.08)] ** 2)))
    equidistant, diffused, minimal = figures
    assert diffused < 0.5 * equidistant
    assert minimal < 0.6 * diffused
    assert set(field.history.column("phase")) == {0, 1}


def test_levels_end_at_the_resolution_and_resolve_the_gap() -> None:
    assert levels(128, 0.081) == [96, 128]
    assert levels(256, 0.081) == [108, 144, 192, 256]
    assert levels(64, 0.081) == [92], "too coarse for the gap: raised"
    assert levels(48, 0.7) == [36, 48]
