"""The one entrance to the field solvers; torch is imported for the neural methods only."""

from __future__ import annotations

from pathlib import Path

from dualms.domain import Domain
from dualms.field.field import Field
from dualms.progress import Progress
from dualms.skeletons import Skeletons
from dualms.spec import DistilledField, NeuralField, PhaseField


def solve_field(
    domain: Domain,
    skeletons: Skeletons,
    spec: PhaseField | NeuralField | DistilledField,
    seed: int,
    device: str,
    checkpoint: Path | None,
    progress: Progress,
) -> Field:
    """Solve for the field that separates two skeletons.

    Parameters
    ----------
    domain, skeletons
        Unit-cube frame.
    spec
        The resolved method.
    seed
        Of everything random; the phase field uses nothing random.
    device
        A torch device; the phase field runs on the CPU whatever it says.
    checkpoint
        File that a neural method writes at most two minutes apart and resumes from; ``None`` for none.
    progress
        Told about stage ``"field"``.
    """
    if isinstance(spec, PhaseField):
        from dualms.field.phase_field import solve_phase_field

        return solve_phase_field(domain, skeletons, spec.resolution, spec.minimality, progress)
    from dualms.field.training import train

    return train(domain, skeletons, spec, seed, device, checkpoint, progress)
