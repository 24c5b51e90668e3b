"""The seam to what only GPUs do: the same numbers, however they come about."""

from __future__ import annotations

import pytest
import torch

from dualms.field.acceleration import accelerated
from dualms.field.losses import Clusters, Mirrored, smoothness_secants
from dualms.field.training import Model
from dualms.spec import NeuralField

SPEC = NeuralField(method="neural", features=64, width=64)


def _model(device: torch.device) -> Model:
    return Model(SPEC, torch.Generator(device).manual_seed(0))


def _slope(model: Model, passes: Mirrored) -> torch.Tensor:
    """All derivatives of the smoothness loss on one batch."""
    generator = torch.Generator(model.frequencies.device).manual_seed(1)
    device = generator.device
    points = torch.rand((4, 32, 3), generator=generator, device=device)
    clusters = Clusters(torch.full((4, 3), 0.5, device=device), points, torch.ones((4, 32), device=device))
    slopes = torch.autograd.grad(smoothness_secants(passes, clusters, generator), model.parameters)
    return torch.cat([slope.flatten() for slope in slopes]).cpu()


def test_the_cpu_is_left_as_it_is() -> None:
    model = _model(torch.device("cpu"))
    assert accelerated(model, torch.device("cpu")) is model


def test_half_precision_would_spoil_the_secants() -> None:
    model = _model(torch.device("cpu"))

    class Halved:
        def mirrored(self, centres: torch.Tensor, offsets: torch.Tensor) -> torch.Tensor:
            with torch.autocast("cpu", dtype=torch.bfloat16):
                return model.mirrored(centres, offsets).float()

    exact = _slope(model, model)
    assert (_slope(model, Halved()) - exact).norm() > 0.1 * exact.norm()


@pytest.mark.gpu
def test_compiled_passes_give_the_same_slopes() -> None:
    device = torch.device("cuda")
    model = _model(device)
    passes = accelerated(model, device)
    exact = _slope(model, model)
    for _ in range(3):  # the first calls compile and record
        assert (_slope(model, passes) - exact).norm() < 1e-2 * exact.norm()


@pytest.mark.gpu
def test_functions_that_are_differentiated_twice_stay_uncompiled() -> None:
    device = torch.device("cuda")
    model = _model(device)
    assert accelerated(model, device, twice_differentiated=True) is model
