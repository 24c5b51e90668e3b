"""How far a design is, from how far its stage is: the share of the whole time that each stage usually takes."""

from __future__ import annotations

from dualms.steps import STAGES, Step

# Seconds on 2 cores at 300 sites and grid 256; only their ratios matter. The neural field takes minutes.
_SECONDS = {
    "domain": 4.0,
    "flow": 4.0,
    "graph": 6.0,
    "partition": 2.0,
    "skeletons": 1.0,
    "field": 20.0,
    "surface": 8.0,
    "body": 15.0,
    "report": 15.0,
    "evaluation": 240.0,
}
_NEURAL_FIELD = 240.0


def progress_of(steps: tuple[Step, ...], neural: bool, step: Step, stage: str | None, fraction: float) -> float:
    """Done part of the whole design.

    Parameters
    ----------
    steps
        Steps of the design.
    neural
        Whether its field is a neural one.
    step, stage, fraction
        Where it is now; a stage of None means that the step has not begun.

    Returns
    -------
    float
        0 to 1.
    """
    seconds = {s: _SECONDS[s] for name in steps for s in STAGES[name]}
    if neural:
        seconds["field"] = _NEURAL_FIELD
    done = 0.0
    for name in steps:
        for s in STAGES[name]:
            if name == step and stage in (s, None):
                part = min(max(fraction, 0.0), 1.0) if stage == s else 0.0
                return (done + part * seconds[s]) / sum(seconds.values())
            done += seconds[s]
    return 1.0
