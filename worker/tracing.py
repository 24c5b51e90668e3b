"""Traces across API, queue and step, as an option: unless DUALMS_TRACING is set, nothing here does anything.

A trace goes with the design: its record keeps the context of the request that made it (``traceparent``, W3C Trace
Context). Every step's span belongs to that request's trace, whichever machine carries it out, and after retries.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

Attributes = Mapping[str, str | int | float | bool]


class Tracing:
    """No traces: what is used unless :func:`open_tracing` was asked for more."""

    on = False
    provider: Any = None  # OpenTelemetry's, for what makes spans of its own (FastAPI does for requests)

    def span(self, name: str, parent: str | None = None) -> AbstractContextManager[None]:
        """A span around the block; ``parent`` is a context (by default the span around this one)."""
        return nullcontext()

    def past(self, name: str, began: float, ended: float) -> None:
        """A span within the one at hand, of what is over; times in seconds since 1970."""

    def note(self, attributes: Attributes) -> None:
        """Say more about the span at hand."""

    def fail(self, reason: str) -> None:
        """Say that what the span at hand stands for went wrong."""

    def context(self) -> str | None:
        """The span at hand as ``traceparent``, to go on elsewhere; None without one."""
        return None


def open_tracing(wanted: bool, process: str) -> Tracing:
    """Traces of this process, sent as OTLP over HTTP to where the standard variables OTEL_EXPORTER_OTLP_… say.

    Parameters
    ----------
    wanted
        The setting; without it nothing of OpenTelemetry is imported.
    process
        Name of the service in the traces, where OTEL_SERVICE_NAME gives none.

    Raises
    ------
    ImportError
        If it is wanted and the extra ``dualms[otel]`` is not installed.
    """
    if not wanted:
        return Tracing()
    from worker.otel import exported

    return exported(process)
