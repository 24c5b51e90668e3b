from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from dualms.domain import Domain
from dualms.errors import FieldDiverged
from dualms.field import topology, training
from dualms.field.field import Field
from dualms.field.lattice import Lattice
from dualms.field.losses import Clusters, Trainable, skeleton_loss, smoothness_exact, smoothness_secants
from dualms.field.objectives import Samples, stray_voxels
from dualms.field.phase_field import solve_phase_field
from dualms.field.solve import solve_field
from dualms.grid import Grid
from dualms.progress import Silent
from dualms.spec import DistilledField, NeuralField

SMALL = NeuralField(
    method="neural",
    steps=120,
    points=256,
    features=64,
    width=32,
    learning_rate=1e-2,
    decay_every=20,
    gradient="secants",
)


@pytest.fixture(autouse=True)
def _coarse_sampling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "_SAMPLING_RESOLUTION", 32)
    # Threads cost more than they save on so small a network.
    torch.set_num_threads(1)


class Stop(Exception):
    pass


class StopAt:
    """Interrupts the run at a fraction, as a cancelled or killed job would."""

    def __init__(self, fraction: float) -> None:
        self.fraction = fraction

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        if fraction >= self.fraction:
            raise Stop


def solve(domain: Domain, skeletons: SimpleNamespace, spec: NeuralField, checkpoint: Path | None = None) -> Field:
    return solve_field(domain, skeletons, spec, 3, "cpu", checkpoint, Silent())


def test_skeleton_loss_is_equation_4() -> None:
    loss = skeleton_loss(torch.tensor([1.0, 0.5]), torch.tensor([-1.0, -1.0, 2.0]))
    assert loss.item() == pytest.approx(0.25 + 1.0)


class Linear:
    """x · slope."""

    slope = torch.tensor([1.0, -2.0, 2.0])

    def __call__(self, points: torch.Tensor, /) -> torch.Tensor:
        return points @ self.slope

    def mirrored(self, centres: torch.Tensor, offsets: torch.Tensor) -> torch.Tensor:
        return torch.stack([self(centres[:, None] + offsets), self(centres[:, None] - offsets)])


def clusters(groups: int, each: int, generator: torch.Generator) -> Clusters:
    """Points of the unit cube about its own centre, whose mirror images are uniform there, too."""
    points = torch.rand((groups, each, 3), generator=generator)
    return Clusters(torch.full((groups, 3), 0.5), points, torch.ones((groups, each)))


def test_exact_smoothness_of_a_linear_field_is_the_length_of_its_gradient() -> None:
    points = torch.rand((100, 3), generator=torch.Generator().manual_seed(0))
    assert smoothness_exact(Linear(), points).item() == pytest.approx(3, rel=1e-5)


def test_smoothness_by_secants_of_a_linear_field_is_the_length_of_its_gradient() -> None:
    generator = torch.Generator().manual_seed(0)
    # 10,000 random lines: the mean of 2|cos| has a standard error of 0.6 %.
    found = smoothness_secants(Linear(), clusters(4, 2500, generator), generator).item()
    assert found == pytest.approx(3, rel=0.02)


def test_points_without_a_mirror_image_do_not_count() -> None:
    class Steep(Linear):
        """Ten times as steep beyond the cube."""

        def __call__(self, points: torch.Tensor, /) -> torch.Tensor:
            return (points @ self.slope) * torch.where((points.abs() > 2).any(dim=-1), 10.0, 1.0)

    generator = torch.Generator().manual_seed(0)
    found = clusters(4, 5000, generator)
    half = found.valid.clone()
    half[:, ::2] = 0
    moved = found.points.clone()
    moved[:, ::2] += 5
    smoothness = smoothness_secants(Steep(), Clusters(found.centres, moved, half), generator).item()
    assert smoothness == pytest.approx(3, rel=0.02)


def test_secants_agree_with_the_exact_gradient_on_the_network() -> None:
    spec = NeuralField(method="neural", features=64, width=32)
    model = training.Model(spec, torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(2)
    found = clusters(4, 5000, generator)
    exact = smoothness_exact(model, found.points.flatten(0, 1)).item()
    assert smoothness_secants(model, found, generator).item() == pytest.approx(exact, rel=0.03)


def test_the_network_of_a_torus_is_periodic() -> None:
    model = training.Model(SMALL, torch.Generator().manual_seed(1), periodic=True)
    points = torch.rand((50, 3), generator=torch.Generator().manual_seed(2))
    there = points + torch.tensor([1.0, -1.0, 2.0])
    torch.testing.assert_close(model(there), model(points), atol=1e-5, rtol=0)
    assert model(points).std() > 1e-3


def test_mirror_images_have_the_values_and_slopes_of_single_points() -> None:
    model = training.Model(SMALL, torch.Generator().manual_seed(1))
    centres, offsets = torch.rand((3, 3)), torch.rand((3, 20, 3)) - 0.5
    singly = [model((centres[:, None] + sign * offsets).reshape(-1, 3)).reshape(3, 20) for sign in (1, -1)]
    together = model.mirrored(centres, offsets)
    torch.testing.assert_close(together, torch.stack(singly), atol=2e-5, rtol=0)
    weights = torch.rand((2, 3, 20))
    slopes = [torch.autograd.grad((v * weights).sum(), model.parameters) for v in (torch.stack(singly), together)]
    for one, other in zip(*slopes, strict=True):
        torch.testing.assert_close(one, other, atol=2e-4, rtol=1e-4)


def test_clusters_and_their_mirror_images_are_uniform_in_the_domain() -> None:
    inside = np.ones((8, 8, 4), dtype=bool)
    inside[4:, 4:] = False  # an L of three equal arms
    lattice = SimpleNamespace(grid=Grid(np.full(3, 1 / 16), 1 / 8, inside.shape), inside=inside)
    nothing = np.zeros((1, 3))
    samples = Samples.of(lattice, SimpleNamespace(hot=nothing, cold=nothing), torch.device("cpu"))
    generator = torch.Generator().manual_seed(0)
    shares = []
    for _ in range(500):
        found = samples.clusters(1024, generator)
        images = 2 * found.centres[:, None] - found.points
        weights = found.valid / found.valid.sum(dim=1, keepdim=True)
        for points in (found.points, images):
            voxel = (8 * points).long()[found.valid > 0]
            assert inside[tuple(voxel.T)].all()
            x, y = points[..., 0] < 0.5, points[..., 1] < 0.5
            shares.append([(weights * arm).sum(dim=1).mean().item() for arm in (x & y, ~x & y, x & ~y)])
    # 2,000 centres: the standard error of a share is below 1 %.
    np.testing.assert_allclose(np.mean(shares, axis=0), 1 / 3, atol=0.03)
    paper = samples.clusters(32_768, generator)
    assert paper.points.shape == (64, 64, 3), "a large batch has more centres, and all its lines together 32,768 points"


def test_training_separates_two_lines_near_the_middle(unit_box: Domain, parallel_lines: SimpleNamespace) -> None:
    field = solve(unit_box, parallel_lines, SMALL)
    grid = unit_box.grid(24, padding=0)
    x, y, _ = grid.points().T.reshape(3, *grid.shape)
    hot = field.on(grid) > 0
    # Far from both lines so short a training decides nothing.
    near = np.abs(y - 0.5) < 0.08
    assert hot[near & (np.abs(x - 0.25) < 0.08)].all()
    assert not hot[near & (np.abs(x - 0.75) < 0.08)].any()
    loss = field.history.column("loss")
    assert loss[-1] < 0.1 * loss[0]


def test_the_numpy_network_is_the_trained_one() -> None:
    model = training.Model(SMALL, torch.Generator().manual_seed(0))
    points = np.random.default_rng(0).random((200, 3))
    with torch.no_grad():
        expected = model(torch.tensor(points, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(model.network().at(points), expected, atol=2e-6)


def test_a_large_batch_is_the_mean_of_its_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "_PIECE", 100)
    asked = []

    def slope_of_the_piece(model: Trainable, points: int, generator: torch.Generator) -> tuple[torch.Tensor, ...]:
        asked.append(points)
        loss = len(asked) * run.model.parameters[0].sum()
        return loss, loss, torch.zeros(())

    run = training.Training(SMALL, [(1, slope_of_the_piece)], 0, torch.device("cpu"))
    before = run.model.parameters[0].sum().item()
    run.advance()
    assert asked == [85, 85, 85]  # of 256
    torch.testing.assert_close(run.model.parameters[0].grad, torch.full_like(run.model.parameters[0], 2.0))
    assert run.history().column("loss")[0] == pytest.approx(2 * before, rel=1e-5)


def test_resuming_gives_the_same_bytes(
    unit_box: Domain, parallel_lines: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "CHECKPOINT_SECONDS", 0.0)
    spec = SMALL.model_copy(update={"connect": True})
    whole = solve(unit_box, parallel_lines, spec)
    checkpoint = tmp_path / "checkpoint"
    with pytest.raises(Stop):
        solve_field(unit_box, parallel_lines, spec, 3, "cpu", checkpoint, StopAt(0.4))
    assert checkpoint.exists()
    resumed = solve(unit_box, parallel_lines, spec, checkpoint)
    for (a, b), (c, d) in zip(whole.source.layers, resumed.source.layers, strict=True):
        assert a.tobytes() == c.tobytes()
        assert b.tobytes() == d.tobytes()
    assert whole.history.rows.tobytes() == resumed.history.rows.tobytes()


def test_a_checkpoint_of_another_specification_is_not_taken_up(
    unit_box: Domain, parallel_lines: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "CHECKPOINT_SECONDS", 0.0)
    solve(unit_box, parallel_lines, SMALL.model_copy(update={"steps": 60}), tmp_path / "c")
    fresh = solve(unit_box, parallel_lines, SMALL)
    other = solve(unit_box, parallel_lines, SMALL, tmp_path / "c")
    assert fresh.source.layers[0][0].tobytes() == other.source.layers[0][0].tobytes()


def test_divergence_is_said(unit_box: Domain, parallel_lines: SimpleNamespace) -> None:
    with pytest.raises(FieldDiverged, match="step"):
        solve(unit_box, parallel_lines, SMALL.model_copy(update={"learning_rate": 1e30}))


def test_stray_pockets_are_found_and_taught(unit_box: Domain, parallel_lines: SimpleNamespace) -> None:
    lattice = Lattice.of(unit_box, parallel_lines, 32)
    x, y, z = (lattice.grid.points(lattice.inside) - 0.5).T
    values = np.where(x < 0, 1.0, -1.0).astype(np.float32)
    assert not stray_voxels(lattice, values)[0].any()
    values[np.hypot(x - 0.3, y - 0.4) ** 2 + z**2 < 0.05**2] = 1
    wrong, wanted = stray_voxels(lattice, values)
    assert 5 < wrong.sum() < 40
    assert not wanted[wrong].any()
    assert topology.component_counts(wanted, lattice.inside) == (1, 1)


def test_presets_fill_only_what_is_left_open() -> None:
    assert NeuralField(method="neural").hidden_layers == 3
    assert NeuralField(method="neural", preset="released").hidden_layers == 4
    cpu = NeuralField(method="neural", preset="cpu", steps=7)
    assert (cpu.steps, cpu.gradient, cpu.skeleton_weight) == (7, "secants", 5000)


def test_distilled_network_takes_over_the_phase_field(unit_box: Domain, schwarz_p: SimpleNamespace) -> None:
    spec = DistilledField(
        method="distilled",
        resolution=24,
        features=128,
        width=32,
        fourier_scale=1.0,
        points=512,
        teaching_steps=250,
        steps=5,
        decay_every=40,
        learning_rate=1e-2,
    )
    field = solve_field(unit_box, schwarz_p, spec, 0, "cpu", None, Silent())
    teacher = solve_phase_field(unit_box, schwarz_p, 24, spec.minimality, Silent())
    grid = unit_box.grid(32, padding=0)
    taught, solved = field.on(grid), teacher.on(grid)
    clear = np.abs(solved) > 0.03
    assert ((taught > 0) == (solved > 0))[clear].mean() > 0.99
    assert field.method == "distilled"
