"""Which queue a step waits in."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line asks for the names of the queues: it need not load what they are for
    from dualms.spec import Spec
    from dualms.steps import Step
    from worker.views import QueueName

QUEUES: tuple[QueueName, ...] = ("cpu", "gpu", "cfd")


def queue_of(step: Step, spec: Spec, live: Collection[str]) -> QueueName:
    """The queue of a step.

    Parameters
    ----------
    step, spec
        What is to be done.
    live
        Queues that some worker serves now.

    Returns
    -------
    str
        ``cfd`` for the evaluation; ``gpu`` for a neural field where a GPU worker is registered; ``cpu`` otherwise.
    """
    if step == "evaluate":
        return "cfd"
    if step == "solve" and spec.field.method not in ("auto", "phase-field") and "gpu" in live:
        return "gpu"
    return "cpu"
