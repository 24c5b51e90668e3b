"""A certified solid goes into a slicer: it finds nothing to repair, and makes layers up to the top."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import trimesh

from tests.dualms.bodies import build_box
from tests.dualms.shapes import end_ports, small_spec

pytestmark = pytest.mark.slow

LAYER_MM = 0.5
# What PrusaSlicer states of a model that it had to repair, or would have to.
TROUBLE = (
    "open_edges",
    "degenerate_facets",
    "edges_fixed",
    "facets_removed",
    "facets_reversed",
    "backwards_edges",
)


@pytest.fixture(scope="module")
def slicer() -> str:
    """The program."""
    found = shutil.which("prusa-slicer")
    if found is None:
        pytest.skip("prusa-slicer is not installed (Debian: apt-get install prusa-slicer)")
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small certified design in a box of 80 x 60 x 40 mm."""
    folder = tmp_path_factory.mktemp("sliced")
    spec = small_spec(end_ports(), graph={"sites": 32}, wall={"thickness": 1.2})
    build_box(folder, spec)
    report = json.loads((folder / "report.json").read_text())
    assert report["certified"], [line for line in report["certificate"] if not line["passed"]]
    return folder


def _said(slicer: str, *arguments: str) -> str:
    done = subprocess.run([slicer, *arguments], capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def _info(slicer: str, path: Path) -> dict[str, str]:
    return dict(re.findall(r"^(\w+) = +(\S+)$", _said(slicer, "--info", str(path)), re.M))


def test_the_slicer_reports_an_open_mesh(slicer: str, tmp_path: Path) -> None:
    """So that the silence of the next tests means something."""
    box = trimesh.creation.box((20, 20, 20))
    box.update_faces([True] * 11 + [False])
    box.export(tmp_path / "open.stl")
    info = _info(slicer, tmp_path / "open.stl")
    assert info["manifold"] == "no"
    assert info["open_edges"] == "3"


@pytest.mark.parametrize("name", ["solid.stl", "solid.3mf"])
def test_the_slicer_finds_one_manifold_part_of_the_reports_volume(slicer: str, folder: Path, name: str) -> None:
    info = _info(slicer, folder / name)
    assert info["manifold"] == "yes"
    assert info["number_of_parts"] == "1"
    assert not set(TROUBLE) & set(info)
    assert [float(info[f"size_{axis}"]) for axis in "xyz"] == pytest.approx([80, 60, 40], abs=1e-4)
    report = json.loads((folder / "report.json").read_text())
    # The slicer sums tetrahedra in single precision.
    assert float(info["volume"]) == pytest.approx(report["solid_volume_m3"] * 1e9, rel=1e-3)


def test_the_slicer_makes_layers_up_to_the_top(slicer: str, folder: Path, tmp_path: Path) -> None:
    settings = f"--center 100,100 --layer-height {LAYER_MM} --first-layer-height {LAYER_MM} --nozzle-diameter 0.6"
    plain = "--perimeters 1 --fill-density 0 --top-solid-layers 0 --bottom-solid-layers 0 --skirts 0"
    out = tmp_path / "solid.gcode"
    _said(slicer, "--export-gcode", *settings.split(), *plain.split(), "-o", str(out), str(folder / "solid.stl"))
    heights = [float(z) for z in re.findall(r"^;Z:(\S+)$", out.read_text(), re.M)]
    assert len(heights) == 40 / LAYER_MM
    assert heights[-1] == pytest.approx(40)
