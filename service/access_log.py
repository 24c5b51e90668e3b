"""One line in the log for each request that changes something, is refused for who asked it, or breaks the service.

Reads that go well are not logged: status polls are most of what the API does, and the metrics count them.
"""

from __future__ import annotations

import logging
from typing import Any

from starlette.types import Scope

log = logging.getLogger("dualms.access")

READING = frozenset({"GET", "HEAD", "OPTIONS"})
REFUSED = frozenset({401, 403, 429})


def write(scope: Scope, status: int, seconds: float, place: str) -> None:
    """Log method, path, status, duration, key and job of a request that has ended, if it is worth a line.

    Parameters
    ----------
    scope
        The request.
    status, seconds
        How it was answered, and how long it took.
    place
        Address of what it has made, if anything.
    """
    if scope["method"] in READING and status not in REFUSED and status < 500:
        return
    caller = scope.get("state", {}).get("caller")
    key = getattr(caller, "key", None)
    detail: dict[str, Any] = {"status": status, "ms": round(1e3 * seconds, 1)}
    if key is not None:
        detail |= {"owner": key.owner, "key_id": key.id}
    job_id = scope.get("path_params", {}).get("design_id")
    if job_id is None and place.startswith("/v1/designs/"):
        job_id = place.rpartition("/")[2]  # one that this request has made
    log.info("%s %s", scope["method"], scope["path"], extra={"job_id": job_id, "detail": detail})
