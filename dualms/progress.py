"""Progress and cancelling, as one object that the stages call and the callers implement."""

from __future__ import annotations

from typing import Protocol


class Cancelled(Exception):
    """Raised out of ``Progress.report`` when the caller no longer wants the result: a signal, not an error."""


class Progress(Protocol):
    """Where a stage reports to, and where it learns that it should stop."""

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        """Say how far a stage is.

        Parameters
        ----------
        stage
            One of ``dualms.steps.STAGES``.
        fraction
            Done part of this stage, 0 to 1, not decreasing.
        note
            A short text for people, such as ``"iteration 12 of 40, area 2.24"``.

        Raises
        ------
        Cancelled
            If the caller wants the work to stop.
        """


class Silent:
    """Progress that nobody watches."""

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        """Ignore the report."""
