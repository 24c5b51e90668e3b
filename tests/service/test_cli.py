"""The command line: exit codes, one-line errors, and the same design with and without a server."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from service.client import Client, ServiceError, Unreachable
from tests.service.designs import small

if TYPE_CHECKING:
    from conftest import Served


def dualms(*words: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command line."""
    env = {**os.environ, "COLUMNS": "160", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "service.cli", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False, env=env, cwd=cwd)


@pytest.fixture
def spec_file(tmp_path: Path, spec: dict[str, Any]) -> Path:
    path = tmp_path / "spec.json"
    path.write_text(json.dumps(spec))
    return path


@pytest.fixture(scope="module")
def submitted(
    served: Served, made: dict[str, Any], box: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Any]:
    """What `dualms submit` leaves: the folder, and how it ended."""
    folder = tmp_path_factory.mktemp("submitted")
    (folder / "spec.json").write_text(json.dumps(SPEC))
    done = dualms(
        "submit", box, folder / "spec.json", "--url", served.url, "--out", folder / "got",
        "--require", "leak_free", "--require", "fluids.hot.components >= 1 and solid_volume_fraction < 0.9",
    )  # fmt: skip
    return folder / "got", done


SPEC: dict[str, Any] = small(units="mm")


def test_submit_waits_downloads_and_checks_the_requirements(submitted: tuple[Path, Any]) -> None:
    folder, done = submitted
    assert done.returncode == 0, done.stderr
    assert {p.name for p in folder.iterdir()} >= {"solid.3mf", "report.json", "report.html", "preview.png"}
    assert done.stdout.count("met: ") == 2
    assert str(folder / "solid.stl") in done.stdout


def test_submit_leaves_with_1_where_a_requirement_fails(
    served: Served, made: dict[str, Any], box: Path, spec_file: Path
) -> None:
    spec_file.write_text(json.dumps(SPEC))
    done = dualms("submit", box, spec_file, "--url", served.url, "--require", "solid_volume_fraction < 0.001")
    assert done.returncode == 1
    assert "NOT met: solid_volume_fraction < 0.001" in done.stdout


def test_submit_without_wait_prints_the_record(served: Served, box: Path, spec_file: Path) -> None:
    spec_file.write_text(json.dumps(SPEC))
    done = dualms("submit", box, spec_file, "--url", served.url, "--name", "quick")
    assert done.returncode == 0
    assert json.loads(done.stdout)["name"] == "quick"


@pytest.mark.slow
def test_design_without_a_server_gives_the_service_s_meshes(
    submitted: tuple[Path, Any], box: Path, tmp_path: Path
) -> None:
    (tmp_path / "spec.json").write_text(json.dumps(SPEC))
    done = dualms("design", box, tmp_path / "spec.json", "--out", tmp_path / "here", "--require", "leak_free")
    assert done.returncode == 0, done.stderr
    assert {p.name for p in (tmp_path / "here").iterdir()} == {p.name for p in submitted[0].iterdir()}
    for name in ("solid.stl", "surface.stl", "skeletons.json", "field.safetensors"):
        assert (tmp_path / "here" / name).read_bytes() == (submitted[0] / name).read_bytes(), name


@pytest.mark.parametrize(
    ("words", "message", "advice"),
    [
        (["inspect", "BOX"], "carries no length unit", "units"),
        (["inspect", "BOX", "--units", "furlong"], "'furlong' is not a unit", "mm"),
        (["inspect", "no-such.stl", "--units", "mm"], "no-such.stl", ""),
        (["inspect", "SPEC"], "are not read", ".stl"),
        (["design", "BOX", "no-such.json", "--out", "o"], "no-such.json", ""),
        (["design", "BOX", "BOX", "--out", "o"], "is not JSON", ""),
        (["design", "BOX", "SPEC", "--out", "o", "--require", "import os"], "not an expression", ""),
        (["submit", "BOX", "SPEC", "--url", "http://127.0.0.1:9", "--require", "f()"], "not allowed", ""),
        (["worker", "--queues", "tpu"], "no queue 'tpu'", "cpu"),
        (["worker", "--queues", "cpu"], "No broker is known", "DUALMS_REDIS_URL"),
    ],
)
def test_errors_are_one_clear_line_with_advice(
    box: Path, spec_file: Path, tmp_path: Path, words: list[str], message: str, advice: str
) -> None:
    done = dualms(*({"BOX": str(box), "SPEC": str(spec_file)}.get(w, w) for w in words), cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert advice in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "o").exists()


def test_a_bad_specification_is_refused_with_its_fields(box: Path, spec_file: Path, tmp_path: Path) -> None:
    spec_file.write_text(json.dumps({**SPEC, "wal": 1, "graph": {"sites": 2}}))
    done = dualms("design", box, spec_file, "--out", tmp_path / "o")
    assert done.returncode == 2
    assert "wal: " in done.stderr
    assert "graph.sites: " in done.stderr


def test_a_refusal_of_the_service_is_shown_with_its_code(served: Served, box: Path, spec_file: Path) -> None:
    spec_file.write_text(json.dumps({**SPEC, "wall": {"thickness": 99}}))
    done = dualms("submit", box, spec_file, "--url", served.url)
    assert done.returncode == 2
    assert "wall-too-thick" in done.stderr
    assert "try:" in done.stderr


def test_a_failed_design_leaves_with_2_and_its_reason(served: Served, box: Path, spec_file: Path) -> None:
    bad = json.loads(json.dumps(SPEC))
    bad["fluids"]["hot"]["inlets"][0]["center"] = [0, 0, 0]
    spec_file.write_text(json.dumps(bad))
    done = dualms("submit", box, spec_file, "--url", served.url, "--wait")
    assert done.returncode == 2
    assert "port-not-on-boundary" in done.stderr


def test_inspect_lists_facets(box: Path) -> None:
    shown = dualms("inspect", box, "--units", "mm")
    assert "24000 mm³" in shown.stdout
    found = json.loads(dualms("inspect", box, "--units", "mm", "--json").stdout)
    assert [f["index"] for f in found["facets"]] == list(range(6))


def test_doctor_says_what_there_is(tmp_path: Path) -> None:
    done = dualms("doctor", "--data", tmp_path / "data")
    assert done.returncode == 0, done.stdout
    for subject in ("processor", "memory", "GPU", "OpenFOAM", "broker", "store", "libraries"):
        assert subject in done.stdout


def test_every_command_has_help() -> None:
    for name in ("serve", "api", "worker", "design", "submit", "inspect", "doctor"):
        done = dualms(name, "--help")
        assert done.returncode == 0
        assert "Usage" in done.stdout


# --- the Python client --------------------------------------------------------------------------------------------


def test_client_uploads_submits_waits_and_downloads(
    served: Served, made: dict[str, Any], box: Path, tmp_path: Path
) -> None:
    seen: list[str] = []
    with Client(served.url) as client:
        domain = client.upload_domain(box, "mm")
        design = client.wait(
            client.submit(domain["id"], SPEC, name="by client")["id"], lambda r: seen.append(r["status"])
        )
        paths = client.download(design, tmp_path / "out")
        report = client.artifact_json(design, "report.json")
    assert seen[-1] == "succeeded"
    assert len(paths) == len(design["artifacts"])
    assert report == json.loads((tmp_path / "out" / "report.json").read_text())


def test_client_tells_refusals_with_code_and_advice(served: Served) -> None:
    with Client(served.url) as client, pytest.raises(ServiceError) as refusal:
        client.submit("0" * 64, SPEC)
    assert (refusal.value.status, refusal.value.code) == (404, "domain-not-found")
    assert refusal.value.advice


def test_client_gives_up_on_a_service_that_is_not_there() -> None:
    with Client("http://127.0.0.1:9", patience_s=0.5) as client, pytest.raises(Unreachable, match="No answer"):
        client.design("0" * 32)


def test_client_stops_waiting_in_time(served: Served, domain_id: str) -> None:
    with Client(served.url) as client:
        long = {**SPEC, "field": {"method": "neural", "steps": 100_000, "points": 1024}}
        design = client.submit(domain_id, long)
        with pytest.raises(TimeoutError):
            client.wait(design["id"], timeout_s=1)
        assert client.cancel(design["id"])["status"] == "cancelled"
