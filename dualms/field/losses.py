"""The paper's losses (section 5.2, Eq. 4-6) and two ways to the total variation's gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]


class Mirrored(Protocol):
    """A field whose values at mirror images come together."""

    def mirrored(self, centres: Tensor, offsets: Tensor) -> Tensor:
        """(2, G, N) values at centres (G, 3) plus and minus offsets (G, N, 3)."""


class Trainable(Mirrored, Protocol):
    """A field that the losses may ask for."""

    def __call__(self, points: Tensor, /) -> Tensor:
        """(P,) values at points (P, 3)."""


@dataclass(frozen=True)
class Clusters:
    """Points of the domain whose mirror images in a centre lie in the domain too, by centre.

    Parameters
    ----------
    centres
        (G, 3) each the middle of two uniform points of the domain.
    points
        (G, N, 3) uniform in the domain's intersection with its mirror image. Over all centres, points and mirror images
        are uniform in the domain: so are the two that a centre lies between.
    valid
        (G, N) 1; 0 for a point whose mirror image lies outside after all, for want of others.
    """

    centres: Tensor
    points: Tensor
    valid: Tensor


SECANT_POINTS = 4
SECANT_STEP = 1 / 128
"""Points on one line, and their distance in unit-cube units: a fifth of a channel at 300 sites."""


def skeleton_loss(on_hot: Tensor, on_cold: Tensor) -> Tensor:
    """Mean distance of the field to +1 on the hot skeleton and to -1 on the cold one (Eq. 4).

    Parameters
    ----------
    on_hot, on_cold
        (A,) and (B,) values at noisy samples of the skeletons.
    """
    return (on_hot - 1).abs().mean() + (on_cold + 1).abs().mean()


def smoothness_exact(function: Function, points: Tensor) -> Tensor:
    """Mean length of the gradient (Eq. 5), exactly, by differentiating twice.

    Parameters
    ----------
    function
        (P, 3) points to (P,) values.
    points
        (P, 3) uniform in the domain.
    """
    points = points.detach().requires_grad_()
    (gradient,) = torch.autograd.grad(function(points).sum(), points, create_graph=True)
    # The gradient's length has no derivative at 0.
    return torch.sqrt((gradient * gradient).sum(dim=1) + 1e-12).mean()


def smoothness_secants(model: Mirrored, clusters: Clusters, generator: torch.Generator) -> Tensor:
    """Mean length of the gradient (Eq. 5) by Crofton's formula, without a second derivative.

    In space |v| = 2 E|v·d| for a uniformly random direction d. Along short lines in random directions |v·d| is replaced
    by secants, which are exact where the field is monotone along one step and never too long. A line of four points
    costs four evaluations and gives three samples, where the exact gradient costs about 3.4 evaluations a sample; and
    the mirror images of four points come for little more.

    Parameters
    ----------
    model
        The network.
    clusters
        Uniform in the domain; each point and its mirror image is the middle of a line.
    generator
        Of the directions.
    """
    middles = clusters.points
    directions = torch.randn(middles.shape, generator=generator, device=middles.device)
    directions = directions / directions.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    along = SECANT_STEP * (torch.arange(SECANT_POINTS, device=middles.device) - (SECANT_POINTS - 1) / 2)
    offsets = (middles - clusters.centres[:, None])[:, :, None] + along[:, None] * directions[:, :, None]
    values = model.mirrored(clusters.centres, offsets.flatten(1, 2)).reshape(2, *offsets.shape[:3])
    lengths = 2 * (values[..., 1:] - values[..., :-1]).abs().mean(dim=-1) / SECANT_STEP
    shares = clusters.valid / clusters.valid.sum(dim=1, keepdim=True)
    return (shares * lengths.mean(dim=0)).sum(dim=1).mean()
