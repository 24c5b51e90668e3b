"""What the training loop lowers: the paper's losses, or the distance to a field that is already solved."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from dualms.field import topology
from dualms.field.field import Field
from dualms.field.interface import MARGIN, profile
from dualms.field.lattice import Lattice
from dualms.field.losses import (
    SECANT_POINTS,
    Clusters,
    Function,
    Trainable,
    skeleton_loss,
    smoothness_exact,
    smoothness_secants,
)
from dualms.grid import Grid
from dualms.skeletons import Skeletons
from dualms.spec import NetworkField

_LEAST_CENTRES = 4
_POINTS_A_CENTRE = 512
"""Of mirror images: the more centres, the more even a batch, but each costs as much as 30 points."""
_CANDIDATES = 8
"""For each point wanted: of two halves of a domain that are not mirror images, few points are."""
_REPAIR_POINTS = 256
_CLEAR = 0.2
"""Least value, with its sign, that a former pocket is taught: enough for the right colour, no pull beyond."""
_TEACHING_WIDTH = 0.12
"""ε of the taught profile over the gap between the skeletons: smooth enough for the network's frequencies."""
_NEAR_SHARE = 0.75


class Objective(Protocol):
    """A loss to lower by stochastic gradients."""

    def __call__(self, model: Trainable, points: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """The whole loss and its two parts, on a fresh batch of so many points."""


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
    voxels
        (K, 3) their indices in ``inside``.
    inside
        (nx, ny, nz) which voxels are the domain's; none of the outermost.
    """

    hot: Tensor
    cold: Tensor
    corners: Tensor
    spacing: float
    voxels: Tensor
    inside: Tensor

    @classmethod
    def of(cls, lattice: Lattice, skeletons: Skeletons, device: torch.device) -> Samples:
        """Move skeletons and the voxelised domain to a device."""
        corners = lattice.grid.points(lattice.inside) - lattice.grid.spacing / 2
        hot, cold, corners_there = (_there(p, device) for p in (skeletons.hot, skeletons.cold, corners))
        inside = torch.tensor(np.pad(lattice.inside, 1), device=device)
        return cls(hot, cold, corners_there, lattice.grid.spacing, inside.nonzero(), inside)

    def skeleton(self, points: Tensor, count: int, noise_std: float, generator: torch.Generator) -> Tensor:
        """(count, 3) samples of a skeleton with the paper's Gaussian noise (Eq. 7)."""
        chosen = torch.randint(len(points), (count,), generator=generator, device=points.device)
        return points[chosen] + noise_std * torch.randn((count, 3), generator=generator, device=points.device)

    def volume(self, count: int, generator: torch.Generator) -> Tensor:
        """(count, 3) uniform points of the voxelised domain."""
        device = self.corners.device
        chosen = torch.randint(len(self.corners), (count,), generator=generator, device=device)
        return self.corners[chosen] + self.spacing * torch.rand((count, 3), generator=generator, device=device)

    def clusters(self, count: int, generator: torch.Generator) -> Clusters:
        """Middles of lines that together hold ``count`` points: a few centres, and points with their mirror images.

        Of more candidates than are wanted those come first whose mirror images lie inside, without a look at how many.
        Each centre is the middle of the first candidate and its image, so there is always one.
        """
        centres = max(_LEAST_CENTRES, count // _POINTS_A_CENTRE)
        each = max(1, count // (2 * SECANT_POINTS * centres))
        device = self.corners.device
        total = len(self.corners)
        ends = torch.randint(total, (centres, 2), generator=generator, device=device)
        others = torch.randint(total, (centres, _CANDIDATES * each), generator=generator, device=device)
        chosen = torch.cat([ends[:, :1], others], dim=1)
        mirrored = self.voxels[ends].sum(dim=1, keepdim=True) - self.voxels[chosen]
        # Beyond the grid one of its outermost voxels answers: outside.
        valid = self.inside[tuple(mirrored[..., k].clamp(0, n - 1) for k, n in enumerate(self.inside.shape))]
        first = torch.argsort(~valid, dim=1, stable=True)[:, :each]
        jitter = torch.rand((centres, each, 3), generator=generator, device=device)
        return Clusters(
            centres=self.corners[ends].mean(dim=1) + self.spacing / 2,
            points=self.corners[chosen.gather(1, first)] + self.spacing * jitter,
            valid=valid.gather(1, first).float(),
        )


class PaperLoss:
    """λ1 · skeleton loss + λ2 · smoothness loss (Eq. 6), and the sign of former pockets where there were any."""

    def __init__(self, spec: NetworkField, samples: Samples) -> None:
        self.spec = spec
        self.samples = samples
        self.repairs = torch.zeros((0, 4), device=samples.hot.device)

    def __call__(self, model: Trainable, points: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """The whole loss, its skeleton part and its smoothness part."""
        spec, samples = self.spec, self.samples
        half = max(1, points // 2)
        hot = samples.skeleton(samples.hot, half, spec.noise_std, generator)
        cold = samples.skeleton(samples.cold, half, spec.noise_std, generator)
        taught = self._draw_repairs(generator)
        values = model(torch.cat([hot, cold, taught[:, :3]]))
        fidelity = skeleton_loss(values[:half], values[half : 2 * half])
        loss = spec.skeleton_weight * fidelity
        if len(taught):
            loss = loss + spec.skeleton_weight * torch.relu(_CLEAR - taught[:, 3] * values[2 * half :]).mean()
        smoothness = torch.zeros_like(fidelity)
        if spec.smoothness_weight > 0:
            if spec.gradient == "exact":
                smoothness = smoothness_exact(model, samples.volume(points, generator))
            else:
                smoothness = smoothness_secants(model, samples.clusters(points, generator), generator)
            loss = loss + spec.smoothness_weight * smoothness
        return loss, fidelity, smoothness

    def repair(self, lattice: Lattice, model: Function) -> int:
        """Look for stray pockets and teach them from now on; their number of voxels."""
        with torch.no_grad():
            centres = self.samples.corners + self.samples.spacing / 2
            values = torch.cat([model(part) for part in torch.split(centres, 16_384)]).cpu().numpy()
        wrong, wanted = stray_voxels(lattice, values)
        found = np.column_stack([lattice.grid.points(wrong), np.where(wanted[wrong], 1.0, -1.0)])
        self.repairs = torch.cat([self.repairs, _there(found, self.repairs.device)])
        return len(found)

    def _draw_repairs(self, generator: torch.Generator) -> Tensor:
        """(R, 4) points of former pockets and their colours; none as long as there are none."""
        repairs = self.repairs
        if not len(repairs):
            return repairs
        device = repairs.device
        chosen = repairs[torch.randint(len(repairs), (_REPAIR_POINTS,), generator=generator, device=device)]
        jitter = torch.rand((_REPAIR_POINTS, 3), generator=generator, device=device) - 0.5
        return torch.cat([chosen[:, :3] + self.samples.spacing * jitter, chosen[:, 3:]], dim=1)


class Imitation:
    """Mean squared distance to the profile of a solved field, most of it near the zero set.

    Parameters
    ----------
    field
        Distance-like near its zero set.
    lattice
        Where it is sampled: the voxels inside and the margin round them.
    gap
        Typical distance between the skeletons, unit-cube units.
    device
        Of the batches.
    """

    def __init__(self, field: Field, lattice: Lattice, gap: float, device: torch.device) -> None:
        spacing = lattice.grid.spacing
        width = math.ceil(MARGIN / spacing)
        inside = np.pad(lattice.inside, width)
        nx, ny, nz = inside.shape
        grid = Grid(lattice.grid.origin - width * spacing, spacing, (nx, ny, nz))
        wanted = ndimage.distance_transform_edt(~inside) * spacing <= MARGIN
        target = profile(field.on(grid), _TEACHING_WIDTH * gap)
        near = wanted & (np.abs(target) < 0.9)
        self._near = _there(np.column_stack([grid.points(near), target[near]]), device)
        self._all = _there(np.column_stack([grid.points(wanted), target[wanted]]), device)

    def __call__(self, model: Trainable, points: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """The loss, twice, and zero for the smoothness that has no part in it."""
        near = round(_NEAR_SHARE * points)
        batch = torch.cat(
            [
                table[torch.randint(len(table), (count,), generator=generator, device=table.device)]
                for table, count in ((self._near, near), (self._all, points - near))
            ]
        )
        loss = (model(batch[:, :3]) - batch[:, 3]).square().mean()
        return loss, loss, torch.zeros_like(loss)


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


def _there(points: NDArray[np.floating], device: torch.device) -> Tensor:
    return torch.tensor(points, dtype=torch.float32, device=device)
