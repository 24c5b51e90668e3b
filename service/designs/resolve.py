"""What a specification leaves open, decided once, at submission."""

from __future__ import annotations

from dualms.errors import EvaluationUnavailable, MissingUnits
from dualms.spec import AutoField, NeuralField, PhaseField, Spec, Unit


def resolved(spec: Spec, units: Unit | None, queues: frozenset[str]) -> Spec:
    """The specification that is stored and run.

    Parameters
    ----------
    spec
        As the client sent it.
    units
        Unit of the domain's record.
    queues
        Queues that a live worker serves.

    Returns
    -------
    Spec
        With units, and without ``auto``.

    Raises
    ------
    MissingUnits
        If neither the specification nor the domain says the unit.
    EvaluationUnavailable
        If a flow solution is asked for and no worker can give one.
    """
    units = spec.units or units
    if units is None:
        raise MissingUnits("Neither the domain file nor the specification says the unit.", advice="Add units: mm.")
    if spec.evaluation is not None and "cfd" not in queues:
        raise EvaluationUnavailable(
            "A flow solution is asked for, and no worker that can solve flows is registered.",
            advice="Leave evaluation out, or start one: dualms worker --queues cfd on a machine with OpenFOAM.",
            measured={"queues": sorted(queues)},
        )
    field = spec.field
    if isinstance(field, AutoField):
        field = NeuralField(method="neural") if "gpu" in queues else PhaseField(method="phase-field")
    return spec.model_copy(update={"units": units, "field": field})
