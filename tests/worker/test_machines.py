"""Several machines that share three URLs and nothing else; one is cut off in the middle of a job."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.team import WORKERS, Team
from tests.worker.conftest import box_file, small_spec, wait_for

pytestmark = pytest.mark.slow


@pytest.fixture
def team(tmp_path: Path) -> Iterator[Callable[..., Team]]:
    """Starts a team with given settings; skips where there are no network namespaces."""
    started: list[Team] = []

    def start(**settings: str) -> Team:
        try:
            started.append(Team(tmp_path, **settings))
        except PermissionError as error:
            pytest.skip(str(error))
        return started[-1]

    yield start
    for one in started:
        one.close()


def submit(team: Team) -> str:
    content = box_file(team.folder).read_bytes()
    domain = team.ask("POST", "/v1/domains", upload=content.hex(), data={"units": "mm"})
    spec = small_spec().model_dump(mode="json")
    return str(team.ask("POST", "/v1/designs", json={"domain": domain["id"], "spec": spec})["id"])


def of_kind(team: Team, design: str, kind: str) -> list[dict[str, Any]]:
    return [event.data for event in team.records.events(design, limit=10_000) if event.kind == kind]


def test_the_other_machine_takes_over_and_the_late_write_is_refused(team: Callable[..., Team]) -> None:
    cluster = team(DUALMS_LEASE_S="6", DUALMS_HEARTBEAT_S="0.5", DUALMS_REAP_S="1", DUALMS_WORKER_GONE_S="6")
    design = submit(cluster)
    lost = wait_for(lambda: cluster.holder(design))
    cluster.machines.cut(lost)
    wait_for(lambda: of_kind(cluster, design, "retrying"))
    (other,) = set(WORKERS) - {lost}
    wait_for(lambda: cluster.holder(design) == other)
    cluster.machines.join(lost)
    wait_for(lambda: "the lease is lost" in cluster.log(lost))
    final = wait_for(lambda: (d := cluster.records.design(design)) and d.final and d)
    assert final.status == "succeeded", final.error
    events = cluster.records.events(design, limit=10_000)
    assert [e.data["step"] for e in events if e.kind in ("step", "succeeded")] == ["prepare", "solve", "build"]
    (report,) = [a for a in cluster.ask("GET", f"/v1/designs/{design}")["artifacts"] if a["name"] == "report.json"]
    assert cluster.ask("GET", report["href"], follow_redirects=True)["area_m2"] > 0, "by way of a redirect to S3"
