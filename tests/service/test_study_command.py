"""`dualms study`: in this process, resumed, and against a service."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from dualms.study.grid import grid_points
from service.studies.command import read_plan

if TYPE_CHECKING:
    from conftest import Served

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = ["picture.png", "table.csv", "table.html", "table.json"]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "service.cli", "study", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "COLUMNS": "200"})


def study_file(folder: Path, box: Path, spec: dict[str, Any], grid: dict[str, list[Any]]) -> Path:
    path = folder / "walls.json"
    document = {"domain": str(box), "spec": spec, "grid": grid, "metrics": ["solid_volume_fraction", "leak_free"]}
    path.write_text(json.dumps(document))
    return path


@pytest.mark.slow
def test_a_study_here_goes_on_where_it_ended(tmp_path: Path, box: Path, spec: dict[str, Any]) -> None:
    out = tmp_path / "out"
    first = run(study_file(tmp_path, box, spec, {"wall.thickness": [1.0, 12.0]}), "--out", out)
    assert first.returncode == 0, first.stderr
    steps = {path.name: path.stat().st_mtime_ns for path in (out / ".steps").iterdir() if not path.suffix}
    assert len(steps) == 3  # one domain, one field, one body; the other wall leaves no room
    report = (out / "points" / "001" / "report.json").read_bytes()

    again = run(study_file(tmp_path, box, spec, {"wall.thickness": [11.0, 1.0]}), "--out", out)
    assert again.returncode == 0, again.stderr
    assert {path.name: path.stat().st_mtime_ns for path in (out / ".steps").iterdir() if not path.suffix} == steps
    table = json.loads((out / "table.json").read_text())
    assert [row["status"] for row in table["rows"]] == ["failed", "succeeded"]
    assert table["rows"][1]["figures"]["leak_free"] is True
    assert (out / "points" / "002" / "report.json").read_bytes() == report
    assert not (out / "points" / "001").exists()
    assert all((out / name).stat().st_size > 100 for name in FILES)


def test_a_study_in_a_service_is_followed_and_found_again(
    served: Served, tmp_path: Path, box: Path, spec: dict[str, Any]
) -> None:
    file = study_file(tmp_path, box, spec, {"wall.thickness": [1.0]})
    first = run(file, "--url", served.url, "--out", tmp_path / "out")
    assert first.returncode == 0, first.stderr + served.logs()
    again = run(file, "--url", served.url, "--out", tmp_path / "out")
    ids = [line for line in (first.stderr + again.stderr).splitlines() if line.startswith("study ")]
    assert len(ids) == 2
    assert len(set(ids)) == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted([*FILES, "study.json"])


def test_what_is_wrong_with_the_file_is_said_in_one_line(tmp_path: Path, box: Path, spec: dict[str, Any]) -> None:
    refused = run(study_file(tmp_path, box, spec, {"wall.thikness": [1.0]}), "--out", tmp_path / "out")
    assert refused.returncode == 2
    assert "grid.wall.thikness" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_the_example_s_grid_fits_its_specification() -> None:
    for path in (EXAMPLES / "studies").glob("*.json"):
        place, plan = read_plan(path, json.loads(path.read_text()), None)
        assert isinstance(place, Path)
        assert place.exists()
        points = grid_points(plan.spec, plan.grid)
        assert len(points) == math.prod(map(len, plan.grid.values()))
