"""Counts and times of the API's requests, for Prometheus."""

from __future__ import annotations

from functools import lru_cache

from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.types import Scope

LATENCIES = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0)


class Meter:
    """Counts and times requests by route, method and status; long polls and streams fall into the last buckets."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self.requests = Counter("dualms_http_requests", "Requests", ["route", "method", "status"], registry=registry)
        self.seconds = Histogram(
            "dualms_http_request_seconds", "Time to the last byte", ["route"], buckets=LATENCIES, registry=registry
        )

    def count(self, scope: Scope, status: int, seconds: float) -> None:
        """Count one request that has ended."""
        route = getattr(scope.get("route"), "path", "none")
        method = scope["method"] if scope["method"] in _METHODS else "other"
        count, spread = self._of(route, method, status)
        count.inc()
        spread.observe(seconds)

    @lru_cache(maxsize=1024)  # noqa: B019 - one meter lives as long as its app
    def _of(self, route: str, method: str, status: int) -> tuple[Counter, Histogram]:
        return self.requests.labels(route, method, str(status)), self.seconds.labels(route)


_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
