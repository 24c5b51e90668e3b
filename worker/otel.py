"""Traces by OpenTelemetry; see :mod:`worker.tracing` for what they are for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from opentelemetry import trace
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import SERVICE_NAME, SERVICE_VERSION, OTELResourceDetector, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import SpanKind, Status, StatusCode
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

import dualms
from worker.tracing import Attributes, Tracing

_PROPAGATOR = TraceContextTextMapPropagator()
_NANOSECONDS = 1e9


def exported(process: str) -> Traces:
    """Traces that leave this process as OTLP; what is left is sent when it ends."""
    ours = Resource({SERVICE_NAME: process, SERVICE_VERSION: dualms.__version__})
    provider = TracerProvider(resource=ours.merge(OTELResourceDetector().detect()))  # the standard variables come last
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return Traces(provider)


class Traces(Tracing):
    """Traces of one provider."""

    on = True

    def __init__(self, provider: TracerProvider) -> None:
        self.provider = provider
        self._tracer = provider.get_tracer("dualms", dualms.__version__)

    @contextmanager
    def span(self, name: str, parent: str | None = None) -> Iterator[None]:
        """A span around the block; an exception that passes is noted in it."""
        context = _PROPAGATOR.extract({"traceparent": parent}) if parent is not None else None
        with self._tracer.start_as_current_span(name, context, SpanKind.CONSUMER):
            yield

    def past(self, name: str, began: float, ended: float) -> None:
        """A span with the times that are given."""
        span = self._tracer.start_span(name, start_time=int(began * _NANOSECONDS))
        span.end(int(ended * _NANOSECONDS))

    def note(self, attributes: Attributes) -> None:
        """Add attributes to the span at hand."""
        trace.get_current_span().set_attributes(attributes)

    def fail(self, reason: str) -> None:
        """Set the status of the span at hand."""
        trace.get_current_span().set_status(Status(StatusCode.ERROR, reason))

    def context(self) -> str | None:
        """The span at hand."""
        carrier: dict[str, str] = {}
        _PROPAGATOR.inject(carrier)
        return carrier.get("traceparent")
