"""What is done on a GPU alone: TF32 products, and the network's passes as compiled CUDA graphs.

Everything else of the training is the same code on every device. Half precision is not used: the smoothness loss
divides differences of values by 1/128, and eight bits leave little of them (``docs/decisions/0004-field.md``).
"""

from __future__ import annotations

import torch
from torch import Tensor

from dualms.field.losses import Trainable


def accelerated(model: Trainable, device: torch.device, *, twice_differentiated: bool = False) -> Trainable:
    """A network, as fast as a device can have it.

    Parameters
    ----------
    model
        Called with few different numbers of points.
    device
        Where it will be called.
    twice_differentiated
        Whether gradients of its gradients are taken, which compiled passes do not have.

    Returns
    -------
    Trainable
        The network itself, but on CUDA devices.
    """
    if device.type != "cuda":
        return model
    torch.set_float32_matmul_precision("high")
    return model if twice_differentiated else _Compiled(model)


class _Compiled:
    """A network's passes as CUDA graphs."""

    def __init__(self, model: Trainable) -> None:
        self._at, self._mirrored = (
            torch.compile(passes, mode="reduce-overhead", dynamic=False) for passes in (model, model.mirrored)
        )

    def __call__(self, points: Tensor, /) -> Tensor:
        """(P,) values at points (P, 3)."""
        return torch.as_tensor(self._at(points))

    def mirrored(self, centres: Tensor, offsets: Tensor) -> Tensor:
        """(2, G, N) values at centres (G, 3) plus and minus offsets (G, N, 3)."""
        return torch.as_tensor(self._mirrored(centres, offsets))
