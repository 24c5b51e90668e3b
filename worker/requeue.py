"""How a step that did not come to its end goes back to its queue: a bounded number of tries, then failed with why.

Each write names the attempt that it takes away and raises it, so that whoever had it can write no more.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session

from dualms.spec import Spec
from dualms.steps import Step, steps_of
from worker import tables, views
from worker.database import Now
from worker.failures import Failure, worker_lost
from worker.lease import Lease
from worker.records import Records
from worker.routing import queue_of
from worker.rows import change, end, live_queues
from worker.views import DesignRecord


class Requeue:
    """Takes steps away from those who hold them, and lets them wait again."""

    def __init__(self, records: Records) -> None:
        self._database = records.database
        self._max_tries = records.settings.max_tries
        self._gone_s = records.settings.worker_gone_s

    def hand_back(
        self,
        lease: Lease,
        reason: str,
        *,
        counts: bool = True,
        failure: Failure | None = None,
        spec: Spec | None = None,
        **hints: Any,
    ) -> DesignRecord | None:
        """Give a step back, to be started again by anyone.

        Parameters
        ----------
        lease
            What was claimed.
        reason
            For people and the log.
        counts
            Whether this start counts towards ``max_tries`` (being asked to stop does not).
        failure
            What the design fails with if it was started often enough; by default ``worker-lost`` with the reason.
        spec
            A specification to go on with instead, such as one with a smaller batch.
        hints
            Kept with the design.

        Returns
        -------
        DesignRecord or None
            The design afterwards, failed if it was started often enough; None if the lease is lost.
        """
        values: dict[str, Any] = {"hints": lease.hints | hints}
        if spec is not None:
            values |= {"spec": spec.model_dump(mode="json"), "checkpoint": None}
        with self._database.write() as session:
            return self._take_away(
                session,
                lease.design,
                reason,
                tables.Design.attempt == lease.attempt,
                counts=counts,
                failure=failure,
                **values,
            )

    def start_over(self, lease: Lease, reason: str) -> DesignRecord | None:
        """Go back to the first step, because an input is gone or unreadable; what is still good is reused."""
        first = steps_of(lease.spec)[0]
        rounds = int(lease.hints.get("rounds", 0)) + 1
        mine = tables.Design.attempt == lease.attempt
        with self._database.write() as session:
            if rounds > self._max_tries:
                error = worker_lost(lease.step, rounds, reason).as_json()
                end(session, lease.id, "failed", {"error": error}, mine, error=error)
                return None
            return self._take_away(
                session,
                lease.design,
                reason,
                mine,
                counts=False,
                step=first,
                hints={k: v for k, v in lease.hints.items() if k != "code"} | {"rounds": rounds},
                checkpoint=None,
            )

    def expire(self, design: DesignRecord, reason: str) -> DesignRecord | None:
        """Take a step away from a worker that is gone; None if the row has moved on meanwhile."""
        d = tables.Design
        with self._database.write() as session:
            return self._take_away(
                session, design, reason, d.attempt == design.attempt, d.lease_until.is_not(None), counts=True
            )

    def _take_away(
        self,
        session: Session,
        design: DesignRecord,
        reason: str,
        *conditions: Any,
        counts: bool,
        failure: Failure | None = None,
        **values: Any,
    ) -> DesignRecord | None:
        d = tables.Design
        if counts and design.tries >= self._max_tries:
            error = (failure or worker_lost(design.step, design.tries, reason)).as_json()
            kept = end(session, design.id, "failed", {"error": error}, *conditions, error=error)
        else:
            step = values.get("step", design.step)
            kept = change(
                session,
                design.id,
                "retrying",
                {"step": step, "reason": reason},
                *conditions,
                attempt=d.attempt + 1,
                tries=d.tries if counts else d.tries - 1,  # a lease implies at least one try
                **waiting(session, step, Spec.model_validate(values.get("spec", design.spec)), self._gone_s) | values,
            )
        if not kept:
            return None
        return views.design_record(session.get_one(tables.Design, design.id, populate_existing=True))


def waiting(session: Session, step: Step, spec: Spec, gone_s: float) -> dict[str, Any]:
    """Columns of a design whose step waits for a worker; ``gone_s``: after so long a silent worker counts as gone."""
    return {
        "step": step,
        "queue": queue_of(step, spec, live_queues(session, gone_s)),
        "lease_until": None,
        "worker_id": None,
        "dispatched_at": Now(),
        "waiting_since": Now(),
    }
