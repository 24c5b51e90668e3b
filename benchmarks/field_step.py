"""A straightforward transcription of the paper's training step, and what one step of it costs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import torch
from field_cases import Case, Row

from dualms.field.lattice import Lattice
from dualms.field.objectives import PaperLoss, Samples
from dualms.field.training import Training
from dualms.spec import NeuralField

PAPER_STEPS = 51_200
PAPER_POINTS = 32_768


class Transcription:
    """The paper's section 5 written down as it reads: torch modules, two passes, the gradient by autograd."""

    def __init__(self, samples: Samples, points: int) -> None:
        self.samples, self.points = samples, points
        self.generator = torch.Generator().manual_seed(0)
        self.frequencies = 2.0 * torch.randn((3, 1024))
        widths = [2048, 256, 256, 256]
        layers: list[torch.nn.Module] = []
        for k in range(3):
            layers += [torch.nn.Linear(widths[k], widths[k + 1]), torch.nn.Softplus()]
        self.perceptron = torch.nn.Sequential(*layers, torch.nn.Linear(256, 1))
        self.optimizer = torch.optim.Adam(self.perceptron.parameters(), lr=3e-5)

    def field(self, x: torch.Tensor) -> torch.Tensor:
        """f(x)."""
        phase = 2 * math.pi * x @ self.frequencies
        return self.perceptron(torch.cat([torch.sin(phase), torch.cos(phase)], dim=1))[:, 0]

    def advance(self) -> None:
        """One step."""
        hot, cold = (
            self.samples.skeleton(p, self.points // 2, 0.002, self.generator)
            for p in (self.samples.hot, self.samples.cold)
        )
        fidelity = (self.field(hot) - 1).abs().mean() + (self.field(cold) + 1).abs().mean()
        x = self.samples.volume(self.points, self.generator).requires_grad_()
        (gradient,) = torch.autograd.grad(self.field(x).sum(), x, create_graph=True)
        loss = 5000 * fidelity + gradient.norm(dim=1).mean()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()


def steps(case: Case, points: int, repeats: int = 5) -> list[Row]:
    """Seconds of one step at one batch: the transcription, ours with the exact gradient, ours with secants."""
    samples = Samples.of(Lattice.of(case.domain, case.skeletons, 64), case.skeletons, torch.device("cpu"))
    rivals: dict[str, Callable[[], None]] = {"transcription": Transcription(samples, points).advance}
    for gradient in ("exact", "secants"):
        spec = NeuralField(method="neural", points=points, gradient=gradient)
        rivals[f"ours, {gradient}"] = Training(spec, [(100, PaperLoss(spec, samples))], 0, torch.device("cpu")).advance
    times: dict[str, list[float]] = {name: [] for name in rivals}
    # Turn by turn, so that a loaded machine is as unfair to one as to the other.
    for _ in range(repeats + 1):
        for name, advance in rivals.items():
            began = time.perf_counter()
            advance()
            times[name].append(time.perf_counter() - began)
    median = {name: sorted(found[1:])[repeats // 2] for name, found in times.items()}
    return [
        {
            "step": name,
            "points": points,
            "seconds": seconds,
            "times_faster": median["transcription"] / seconds,
            "days_for_the_papers_schedule": seconds * PAPER_POINTS / points * PAPER_STEPS / 86_400,
        }
        for name, seconds in median.items()
    ]
