import itertools
from pathlib import Path

import numpy as np
import pytest

from dualms.field.field import Field, History, load_field, save_field
from dualms.field.network import Network
from dualms.field.samples import GridSamples
from dualms.grid import Grid


def grid_field() -> Field:
    values = np.random.default_rng(0).normal(size=(5, 6, 7)).astype(np.float32)
    history = History(("iteration", "energy"), np.array([[0.0, 2.0], [1.0, 1.5]]))
    return Field(GridSamples(Grid(np.array([0.1, 0.2, 0.3]), 0.05, (5, 6, 7)), values), "phase-field", history, "cpu")


def network_field() -> Field:
    rng = np.random.default_rng(1)
    sizes = (8, 5, 1)
    layers = tuple(
        (rng.normal(size=(a, b)).astype(np.float32), rng.normal(size=b).astype(np.float32))
        for a, b in itertools.pairwise(sizes)
    )
    frequencies = rng.normal(size=(3, 4)).astype(np.float32)
    return Field(Network(frequencies, layers), "neural", History(("iteration",), np.zeros((0, 1))), "cpu")


@pytest.mark.parametrize("make", [grid_field, network_field])
def test_a_field_survives_its_file(make, tmp_path: Path) -> None:
    field = make()
    save_field(field, tmp_path / "a.safetensors")
    save_field(make(), tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    again = load_field(tmp_path / "a.safetensors")
    grid = Grid(np.array([0.12, 0.22, 0.3]), 0.03, (6, 5, 4))
    assert np.array_equal(again.on(grid), field.on(grid))
    assert (again.method, again.device, again.history.columns) == (field.method, field.device, field.history.columns)
    assert np.array_equal(again.history.rows, field.history.rows)


def test_network_in_numpy_is_its_formula() -> None:
    network = network_field().source
    assert isinstance(network, Network)
    point = np.array([0.3, 0.6, 0.9])
    phase = 2 * np.pi * point @ network.frequencies
    hidden = np.concatenate([np.sin(phase), np.cos(phase)]) @ network.layers[0][0] + network.layers[0][1]
    expected = np.log(1 + np.exp(hidden)) @ network.layers[1][0] + network.layers[1][1]
    assert network.at(point[None])[0] == pytest.approx(expected[0], rel=1e-5)
