"""The only training loop: the paper's network, losses and schedule on any torch device (paper, section 5)."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dualms.domain import Domain
from dualms.errors import FieldDiverged
from dualms.field import topology
from dualms.field.field import Field, History
from dualms.field.lattice import Lattice
from dualms.field.losses import skeleton_loss, smoothness_exact, smoothness_secants
from dualms.field.network import Network
from dualms.progress import Progress
from dualms.spec import NeuralField

if TYPE_CHECKING:
    from dualms.skeletons import Skeletons

CHECKPOINT_SECONDS = 60.0
_LOG_EVERY = 10
_LOOK_EVERY = 50
_SAMPLING_RESOLUTION = 128
_REPAIRS = (0.6, 0.7, 0.8, 0.9)
"""Shares of the steps after which stray pockets are looked for."""
_EXTRA_ROUNDS = 6
_EXTRA_STEPS = 50
_REPAIR_POINTS = 256
_CLEAR = 0.2
"""Least value, with its sign, that a former pocket is taught: enough for the right colour, no pull beyond."""


@dataclass(frozen=True)
class Samples:
    """What the batches are drawn from, on the device.

    Parameters
    ----------
    hot, cold
        (P, 3) and (Q, 3) samples of the skeletons.
    corners
        (K, 3) lower corners of the voxels inside the domain.
    spacing
        Edge of these voxels.
    """

    hot: Tensor
    cold: Tensor
    corners: Tensor
    spacing: float

    @classmethod
    def of(cls, lattice: Lattice, skeletons: Skeletons, device: torch.device) -> Samples:
        """Move skeletons and the voxelised domain to a device."""
        corners = lattice.grid.points(lattice.inside) - lattice.grid.spacing / 2

        def move(points: np.ndarray) -> Tensor:
            return torch.tensor(points, dtype=torch.float32, device=device)

        return cls(move(skeletons.hot), move(skeletons.cold), move(corners), lattice.grid.spacing)

    def skeleton(self, points: Tensor, count: int, noise_std: float, generator: torch.Generator) -> Tensor:
        """(count, 3) samples of a skeleton with the paper's Gaussian noise (Eq. 7)."""
        chosen = torch.randint(len(points), (count,), generator=generator, device=points.device)
        return points[chosen] + noise_std * torch.randn((count, 3), generator=generator, device=points.device)

    def volume(self, count: int, generator: torch.Generator) -> Tensor:
        """(count, 3) uniform points of the voxelised domain."""
        device = self.corners.device
        chosen = torch.randint(len(self.corners), (count,), generator=generator, device=device)
        return self.corners[chosen] + self.spacing * torch.rand((count, 3), generator=generator, device=device)


def stray_voxels(lattice: Lattice, values: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which voxels have the wrong sign: stray pockets and skeleton voxels of the other fluid.

    Parameters
    ----------
    lattice
        The voxelised domain.
    values
        (K,) the field at the voxels inside, in C order.

    Returns
    -------
    tuple
        (nx, ny, nz) the wrong voxels, and the colouring that is wanted.
    """
    hot = np.zeros(lattice.grid.shape, dtype=bool)
    hot[lattice.inside] = values > 0
    ours, theirs = lattice.skeleton
    wanted = (hot | (ours & ~theirs)) & ~(theirs & ~ours)
    wanted, _ = topology.without_pockets(wanted, lattice.inside, lattice.skeleton)
    return (wanted != hot) & lattice.inside, wanted


class Model:
    """The network's parameters on a device.

    Parameters
    ----------
    spec
        Width, depth and Fourier features.
    generator
        Of the frequencies and the start, on the same device.
    """

    def __init__(self, spec: NeuralField, generator: torch.Generator) -> None:
        half = spec.features // 2
        device = generator.device
        self.frequencies = spec.fourier_scale * torch.randn((3, half), generator=generator, device=device)
        sizes = [2 * half, *[spec.width] * spec.hidden_layers, 1]
        self.layers: list[tuple[Tensor, Tensor]] = []
        for fan_in, fan_out in itertools.pairwise(sizes):
            bound = 1 / math.sqrt(fan_in)
            weight = (2 * torch.rand((fan_in, fan_out), generator=generator, device=device) - 1) * bound
            bias = (2 * torch.rand(fan_out, generator=generator, device=device) - 1) * bound
            self.layers.append((weight.requires_grad_(), bias.requires_grad_()))

    def __call__(self, points: Tensor) -> Tensor:
        """(P,) values at points (P, 3)."""
        phase = 2 * math.pi * (points @ self.frequencies)
        x = torch.cat([phase.sin(), phase.cos()], dim=1)
        for weight, bias in self.layers[:-1]:
            x = torch.nn.functional.softplus(torch.addmm(bias, x, weight))
        weight, bias = self.layers[-1]
        return torch.addmm(bias, x, weight)[:, 0]

    @property
    def parameters(self) -> list[Tensor]:
        """Everything that is trained."""
        return [tensor for layer in self.layers for tensor in layer]

    def network(self) -> Network:
        """The same network for NumPy."""
        layers = tuple((weight.detach().cpu().numpy(), bias.detach().cpu().numpy()) for weight, bias in self.layers)
        return Network(self.frequencies.cpu().numpy(), layers)


class Training:
    """The state of one run: everything that a checkpoint holds."""

    def __init__(self, spec: NeuralField, samples: Samples, seed: int, device: torch.device) -> None:
        self.spec = spec
        self.samples = samples
        self.generator = torch.Generator(device).manual_seed(seed)
        self.model = Model(spec, self.generator)
        self.optimizer = torch.optim.Adam(self.model.parameters, lr=spec.learning_rate, fused=True)
        self.step = 0
        self.last = spec.steps
        self.repairs = torch.zeros((0, 4), device=device)
        most = spec.steps + _EXTRA_ROUNDS * _EXTRA_STEPS
        self.log = torch.zeros((math.ceil(most / _LOG_EVERY), 3), dtype=torch.float64, device=device)

    def advance(self) -> None:
        """One step of Adam; nothing is copied to the host."""
        spec, generator, samples = self.spec, self.generator, self.samples
        for group in self.optimizer.param_groups:
            group["lr"] = spec.learning_rate * spec.decay ** (self.step // spec.decay_every)
        half = max(1, spec.points // 2)
        hot = samples.skeleton(samples.hot, half, spec.noise_std, generator)
        cold = samples.skeleton(samples.cold, half, spec.noise_std, generator)
        taught = self._draw_repairs()
        values = self.model(torch.cat([hot, cold, taught[:, :3]]))
        fidelity = skeleton_loss(values[:half], values[half : 2 * half])
        loss = spec.skeleton_weight * fidelity
        if len(taught):
            loss = loss + spec.skeleton_weight * torch.relu(_CLEAR - taught[:, 3] * values[2 * half :]).mean()
        smoothness = torch.zeros_like(fidelity)
        if spec.smoothness_weight > 0:
            inside = samples.volume(spec.points, generator)
            if spec.gradient == "exact":
                smoothness = smoothness_exact(self.model, inside)
            else:
                smoothness = smoothness_secants(self.model, inside, generator)
            loss = loss + spec.smoothness_weight * smoothness
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self.optimizer.step()
        if self.step % _LOG_EVERY == 0:
            row = torch.stack([loss.detach(), fidelity.detach(), smoothness.detach()])
            self.log[self.step // _LOG_EVERY] = row.double()
        self.step += 1

    def repair(self, lattice: Lattice) -> int:
        """Look for stray pockets and teach them from now on; their number of voxels."""
        device = self.log.device
        with torch.no_grad():
            centres = self.samples.corners + self.samples.spacing / 2
            values = torch.cat([self.model(part) for part in torch.split(centres, 16_384)]).cpu().numpy()
        wrong, wanted = stray_voxels(lattice, values)
        found = np.column_stack([lattice.grid.points(wrong), np.where(wanted[wrong], 1.0, -1.0)])
        fresh = torch.tensor(found, dtype=torch.float32, device=device)
        self.repairs = torch.cat([self.repairs, fresh])
        return len(found)

    def _draw_repairs(self) -> Tensor:
        """(R, 4) points of former pockets and their targets; none as long as there are none."""
        if not len(self.repairs):
            return self.repairs
        device = self.log.device
        chosen = self.repairs[
            torch.randint(len(self.repairs), (_REPAIR_POINTS,), generator=self.generator, device=device)
        ]
        jitter = torch.rand((_REPAIR_POINTS, 3), generator=self.generator, device=device) - 0.5
        return torch.cat([chosen[:, :3] + self.samples.spacing * jitter, chosen[:, 3:]], dim=1)

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
            "frequencies": self.model.frequencies,
            "parameters": [p.detach() for p in self.model.parameters],
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "log": self.log,
            "repairs": self.repairs,
            "last": self.last,
        }
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
        self.repairs = state["repairs"]
        self.step, self.last = state["step"], state["last"]


def train(
    domain: Domain,
    skeletons: Skeletons,
    spec: NeuralField,
    seed: int,
    device: str,
    checkpoint: Path | None,
    progress: Progress,
) -> Field:
    """Train the paper's network on two skeletons.

    Parameters
    ----------
    domain, skeletons
        Unit-cube frame.
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
    if where.type == "cuda":
        torch.set_float32_matmul_precision("high")
    lattice = Lattice.of(domain, skeletons, _SAMPLING_RESOLUTION)
    training = Training(spec, Samples.of(lattice, skeletons, where), seed, where)
    if checkpoint is not None:
        training.resume(checkpoint)
    saved = time.monotonic()
    looks = {round(share * spec.steps) for share in _REPAIRS} if spec.connect else set()
    most = spec.steps + _EXTRA_ROUNDS * _EXTRA_STEPS
    while training.step < training.last:
        training.advance()
        if training.step in looks:
            training.repair(lattice)
        if spec.connect and training.step == training.last and training.last < most and training.repair(lattice):
            training.last += _EXTRA_STEPS
        if training.step % _LOOK_EVERY == 0 or training.step == training.last:
            losses = training.history().rows[-1]
            if not np.isfinite(losses).all():
                raise FieldDiverged(
                    f"The loss is not finite at step {training.step} of {training.last}.",
                    advice="Lower field.learning_rate.",
                    measured={"step": training.step},
                )
            progress.report(
                "field", min(1.0, training.step / spec.steps), f"step {training.step}, loss {losses[1]:.4g}"
            )
        if checkpoint is not None and time.monotonic() - saved > CHECKPOINT_SECONDS:
            training.save(checkpoint)
            saved = time.monotonic()
    name = torch.cuda.get_device_name(where) if where.type == "cuda" else where.type
    return Field(training.model.network(), spec.method, training.history(), name)
