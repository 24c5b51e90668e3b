"""What is done on a GPU alone: TF32 products, and the network's passes as compiled CUDA graphs.

Everything else of the training is the same code on every device. Half precision is not used: the smoothness loss
divides differences of values by 1/128, and eight bits leave little of them (``docs/decisions/0004-field.md``).
"""

from __future__ import annotations

import torch

from dualms.field.losses import Function


def accelerated(function: Function, device: torch.device, *, twice_differentiated: bool = False) -> Function:
    """A function of points, as fast as a device can have it.

    Parameters
    ----------
    function
        (P, 3) points to (P,) values, called with few different numbers of points.
    device
        Where it will be called.
    twice_differentiated
        Whether gradients of its gradients are taken, which compiled passes do not have.

    Returns
    -------
    Function
        The function itself, but on CUDA devices.
    """
    if device.type != "cuda":
        return function
    torch.set_float32_matmul_precision("high")
    if twice_differentiated:
        return function
    compiled: Function = torch.compile(function, mode="reduce-overhead", dynamic=False)
    return compiled
