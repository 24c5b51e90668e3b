"""The paper's losses (section 5.2, Eq. 4-6) and two ways to the total variation's gradient."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]

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


def smoothness_secants(function: Function, points: Tensor, generator: torch.Generator) -> Tensor:
    """Mean length of the gradient (Eq. 5) by Crofton's formula, without a second derivative.

    In space |v| = 2 E|v·d| for a uniformly random direction d. Along short lines in random directions |v·d| is replaced
    by secants, which are exact where the field is monotone along one step and never too long. A line of four points
    costs four evaluations and gives three samples, where the exact gradient costs about 3.4 evaluations a sample.

    Parameters
    ----------
    function
        (P, 3) points to (P,) values.
    points
        (P, 3) uniform in the domain; every fourth is the middle of a line, so that (P,) values are evaluated.
    generator
        Of the directions.
    """
    middles = points[::SECANT_POINTS]
    directions = torch.randn(middles.shape, generator=generator, device=middles.device)
    directions = directions / directions.norm(dim=1, keepdim=True).clamp_min(1e-6)
    offsets = SECANT_STEP * (torch.arange(SECANT_POINTS, device=middles.device) - (SECANT_POINTS - 1) / 2)
    lines = middles[:, None] + offsets[:, None] * directions[:, None]
    values = function(lines.reshape(-1, 3)).reshape(len(middles), SECANT_POINTS)
    return 2 * (values[:, 1:] - values[:, :-1]).abs().mean() / SECANT_STEP
