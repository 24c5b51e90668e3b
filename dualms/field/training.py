"""The only training loop: the paper's network, losses and schedule on any torch device (paper, section 5)."""

from __future__ import annotations

import itertools
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from dualms.domain import Domain
from dualms.errors import FieldDiverged
from dualms.field.acceleration import accelerated
from dualms.field.field import Field, History
from dualms.field.lattice import Lattice, typical_gap
from dualms.field.network import Network
from dualms.field.objectives import Imitation, Objective, PaperLoss, Samples
from dualms.field.phase_field import solve_phase_field
from dualms.field.torus import Torus
from dualms.progress import Progress
from dualms.skeletons import Skeletons
from dualms.spec import DistilledField, NetworkField, NeuralField

CHECKPOINT_SECONDS = 60.0
_PIECE = 2048
"""Points of a batch that a CPU takes at a time."""
_LOG_EVERY = 10
_LOOK_EVERY = 50
_SAMPLING_RESOLUTION = 128
_REPAIRS = (0.6, 0.7, 0.8, 0.9)
"""Shares of the steps after which stray pockets are looked for."""
_EXTRA_ROUNDS = 6
_EXTRA_STEPS = 50
_TEACHER_SHARE = 0.1
"""Of the progress of a distilled run, spent on the phase field."""


class Model:
    """The network's parameters on a device.

    Parameters
    ----------
    spec
        Width, depth and Fourier features.
    generator
        Of the frequencies and the start, on the same device.
    periodic
        Whether opposite faces of the unit cube are joined: frequencies are whole numbers then.
    """

    def __init__(self, spec: NetworkField, generator: torch.Generator, periodic: bool = False) -> None:
        half = spec.features // 2
        device = generator.device
        self.frequencies = spec.fourier_scale * torch.randn((3, half), generator=generator, device=device)
        if periodic:
            self.frequencies = self.frequencies.round()
        sizes = [2 * half, *[spec.width] * spec.hidden_layers, 1]
        self.layers: list[tuple[Tensor, Tensor]] = []
        for fan_in, fan_out in itertools.pairwise(sizes):
            bound = 1 / math.sqrt(fan_in)
            weight = (2 * torch.rand((fan_in, fan_out), generator=generator, device=device) - 1) * bound
            bias = (2 * torch.rand(fan_out, generator=generator, device=device) - 1) * bound
            self.layers.append((weight.requires_grad_(), bias.requires_grad_()))

    def __call__(self, points: Tensor, /) -> Tensor:
        """(P,) values at points (P, 3)."""
        phase = points @ (2 * math.pi * self.frequencies)
        weight, bias = self.layers[0]
        of_sines, of_cosines = weight.chunk(2)
        return self._beyond(torch.addmm(torch.addmm(bias, phase.sin(), of_sines), phase.cos(), of_cosines))

    def mirrored(self, centres: Tensor, offsets: Tensor) -> Tensor:
        """(2, G, N) values at centres (G, 3) plus and minus offsets (G, N, 3).

        A Fourier feature splits into a part that is even in the offset and one that is odd, sin(c ± u) = sin c cos u ±
        cos c sin u. So the first layer, most of the work, costs for both points what it costs for one.
        """
        centre, offset = (x @ (2 * math.pi * self.frequencies) for x in (centres, offsets))
        sin, cos = centre.sin()[:, :, None], centre.cos()[:, :, None]
        weight, bias = self.layers[0]
        of_sines, of_cosines = weight.chunk(2)
        even = torch.baddbmm(bias, offset.cos(), sin * of_sines + cos * of_cosines)
        odd = torch.bmm(offset.sin(), cos * of_sines - sin * of_cosines)
        both = torch.stack([even + odd, even - odd])
        return self._beyond(both.flatten(0, 2)).reshape(both.shape[:3])

    def _beyond(self, x: Tensor) -> Tensor:
        """(P,) values from the first layer's sums (P, W)."""
        for weight, bias in self.layers[1:]:
            x = torch.addmm(bias, torch.nn.functional.softplus(x), weight)
        return x[:, 0]

    @property
    def parameters(self) -> list[Tensor]:
        """Everything that is trained."""
        return [tensor for layer in self.layers for tensor in layer]

    def network(self) -> Network:
        """The same network for NumPy."""
        layers = tuple((weight.detach().cpu().numpy(), bias.detach().cpu().numpy()) for weight, bias in self.layers)
        return Network(self.frequencies.cpu().numpy(), layers)


class Training:
    """The state of one run: everything that a checkpoint holds.

    Parameters
    ----------
    spec
        Network and schedule.
    lessons
        Objectives and the number of steps on each, one after the other; the last may be prolonged.
    seed
        Of the start and of all batches.
    device
        Where it runs.
    periodic
        Whether the domain is the torus.
    """

    def __init__(
        self,
        spec: NetworkField,
        lessons: list[tuple[int, Objective]],
        seed: int,
        device: torch.device,
        periodic: bool = False,
    ) -> None:
        self.spec = spec
        self.lessons = lessons
        self.generator = torch.Generator(device).manual_seed(seed)
        self.model = Model(spec, self.generator, periodic)
        self.function = accelerated(self.model, device, twice_differentiated=spec.gradient == "exact")
        self.optimizer = torch.optim.Adam(self.model.parameters, lr=spec.learning_rate, fused=True)
        self.step = 0
        self.planned = sum(steps for steps, _ in lessons)
        self.last = self.planned
        self.log = torch.zeros((math.ceil(self.most / _LOG_EVERY), 3), dtype=torch.float64, device=device)

    @property
    def most(self) -> int:
        """Steps beyond which the run is not prolonged."""
        return self.planned + _EXTRA_ROUNDS * _EXTRA_STEPS

    def objective(self) -> Objective:
        """What the next step lowers."""
        begun = 0
        for steps, objective in self.lessons:
            begun += steps
            if self.step < begun:
                return objective
        return self.lessons[-1][1]

    def advance(self) -> None:
        """One step of Adam; nothing is copied to the host.

        The CPU takes a batch in pieces, whose slopes add up: they stay in its cache, and the paper's batch in memory.
        """
        for group in self.optimizer.param_groups:
            group["lr"] = self.spec.learning_rate * self.spec.decay ** (self.step // self.spec.decay_every)
        self.optimizer.zero_grad(set_to_none=True)
        pieces = math.ceil(self.spec.points / _PIECE) if self.log.device.type == "cpu" else 1
        losses = torch.zeros(3, device=self.log.device)
        for _ in range(pieces):
            piece = torch.stack(self.objective()(self.function, self.spec.points // pieces, self.generator)) / pieces
            torch.autograd.backward(piece[0])
            losses += piece.detach()
        self.optimizer.step()
        if self.step % _LOG_EVERY == 0:
            self.log[self.step // _LOG_EVERY] = losses.double()
        self.step += 1

    def history(self) -> History:
        """What was logged so far."""
        rows = self.log[: math.ceil(self.step / _LOG_EVERY)].cpu().numpy()
        iterations = _LOG_EVERY * np.arange(len(rows), dtype=float)
        return History(("iteration", "loss", "skeleton", "smoothness"), np.column_stack([iterations, rows]))

    def save(self, path: Path) -> None:
        """Write the checkpoint; a half-written one never takes its name."""
        state = {
            "spec": self.spec.model_dump_json(),
            "step": self.step,
            "last": self.last,
            "frequencies": self.model.frequencies,
            "parameters": [p.detach() for p in self.model.parameters],
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "log": self.log,
            "repairs": [o.repairs for _, o in self.lessons if isinstance(o, PaperLoss)],
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".partial")
        torch.save(state, partial)
        partial.replace(path)

    def resume(self, path: Path) -> None:
        """Take up a checkpoint of the same specification; leave the start as it is if there is none."""
        if not path.exists():
            return
        state = torch.load(path, map_location=self.log.device, weights_only=True)
        if state["spec"] != self.spec.model_dump_json():
            return
        self.model.frequencies.copy_(state["frequencies"])
        with torch.no_grad():
            for parameter, saved in zip(self.model.parameters, state["parameters"], strict=True):
                parameter.copy_(saved)
        self.optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"].cpu())
        self.log.copy_(state["log"])
        losses = [o for _, o in self.lessons if isinstance(o, PaperLoss)]
        for objective, repairs in zip(losses, state["repairs"], strict=True):
            objective.repairs = repairs
        self.step, self.last = state["step"], state["last"]


def train(
    domain: Domain | Torus,
    skeletons: Skeletons,
    spec: NeuralField | DistilledField,
    seed: int,
    device: str,
    checkpoint: Path | None,
    progress: Progress,
) -> Field:
    """Train the paper's network on two skeletons; the distilled method teaches it the phase field first.

    Parameters
    ----------
    domain, skeletons
        Unit-cube frame; on the torus the network is periodic.
    spec
        Network, losses and schedule.
    seed
        Of the start and of all samples.
    device
        A torch device, such as ``"cpu"`` or ``"cuda:0"``.
    checkpoint
        File to write at most a minute apart and to resume from; ``None`` for none.
    progress
        Told about stage ``"field"``, by step.

    Raises
    ------
    FieldDiverged
        If a loss is not finite.

    Notes
    -----
    On the CPU a resumed run gives the same bytes as an uninterrupted one.
    """
    where = torch.device(device)
    lattice = Lattice.of(domain, skeletons, _SAMPLING_RESOLUTION)
    paper = PaperLoss(spec, Samples.of(lattice, skeletons, where))
    lessons: list[tuple[int, Objective]] = [(spec.steps, paper)]
    begun = 0.0
    if isinstance(spec, DistilledField):
        begun = _TEACHER_SHARE
        teacher = solve_phase_field(domain, skeletons, spec.resolution, spec.minimality, Part(progress, 0.0, begun))
        gap = typical_gap(domain, skeletons)
        lessons.insert(0, (spec.teaching_steps, Imitation(teacher, lattice, gap, where)))
    training = Training(spec, lessons, seed, where, lattice.periodic)
    if checkpoint is not None:
        training.resume(checkpoint)
    _run(training, paper, lattice, checkpoint, Part(progress, begun, 1.0))
    name = torch.cuda.get_device_name(where) if where.type == "cuda" else where.type
    return Field(training.model.network(), spec.method, training.history(), name)


def _run(training: Training, paper: PaperLoss, lattice: Lattice, checkpoint: Path | None, progress: Progress) -> None:
    """The loop: steps, looks at the loss, searches for pockets, checkpoints."""
    connect = training.spec.connect
    looks = {round(share * training.planned) for share in _REPAIRS} if connect else set()
    saved = time.monotonic()
    while training.step < training.last:
        training.advance()
        if training.step in looks:
            paper.repair(lattice, training.model)
        ended = training.step == training.last
        if connect and ended and training.last < training.most and paper.repair(lattice, training.model):
            training.last += _EXTRA_STEPS
        if training.step % _LOOK_EVERY == 0 or training.step == training.last:
            losses = training.history().rows[-1]
            if not np.isfinite(losses).all():
                raise FieldDiverged(
                    f"The loss is not finite at step {training.step} of {training.last}.",
                    advice="Lower field.learning_rate.",
                    measured={"step": training.step},
                )
            fraction = min(1.0, training.step / training.planned)
            progress.report("field", fraction, f"step {training.step}, loss {losses[1]:.4g}")
        if checkpoint is not None and time.monotonic() - saved > CHECKPOINT_SECONDS:
            training.save(checkpoint)
            saved = time.monotonic()


class Part:
    """A part of another's progress."""

    def __init__(self, whole: Progress, begin: float, end: float) -> None:
        self._whole, self._begin, self._end = whole, begin, end

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        """Report a fraction of the part."""
        self._whole.report(stage, self._begin + (self._end - self._begin) * fraction, note)
