"""The whole chain on a small box: two connected fluids, exact volumes, the same bytes again."""

from __future__ import annotations

import gzip
import json
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from dualms.field_file import read as read_field
from dualms.pipeline import run_step
from dualms.progress import Cancelled, Silent
from dualms.reading import read_domain_mesh
from dualms.spec import FluidsSpec, Spec, Unit
from dualms.steps import ARTIFACTS, INTERNAL, OPTIONAL_ARTIFACTS, STAGES, sha256_of, step_keys, steps_of
from tests.dualms.shapes import box_mesh, end_ports, shared_ends, small_spec, with_headers

VOLUME = 80 * 60 * 40
REQUIRED = {"min_passage_m": 0.001, "max_overhang_fraction": 1e-9}  # one that is met, one that cannot be


class Recorder:
    """Progress that keeps what it is told."""

    def __init__(self) -> None:
        self.reports: list[tuple[str, float]] = []

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        self.reports.append((stage, fraction))


def _domain_file(folder: Path) -> Path:
    mesh = box_mesh()
    path = folder / "box.stl"
    shape = trimesh.Trimesh(mesh.vertices_m * 1e3, mesh.faces, process=False)
    path.write_bytes(trimesh.exchange.stl.export_stl(shape))
    return path


def _run(folder: Path, fluids: FluidsSpec, progress: Recorder | None = None, **changes: object) -> Spec:
    folder.mkdir(exist_ok=True)
    spec = small_spec(fluids, **{"require": REQUIRED, **changes})
    for step in steps_of(spec):
        run_step(step, folder, _domain_file(folder), spec, progress or Silent())
    return spec


@pytest.fixture(scope="module", params=["shared", pytest.param("dedicated", marks=pytest.mark.slow)])
def designed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recorder]:
    folder = tmp_path_factory.mktemp(request.param)
    progress = Recorder()
    _run(folder, shared_ends() if request.param == "shared" else end_ports(), progress)
    return folder, progress


def test_every_file_that_a_step_names_is_there(designed: tuple[Path, Recorder]) -> None:
    folder, _ = designed
    for step in ("prepare", "solve", "build"):
        for name in (*ARTIFACTS[step], *INTERNAL[step]):
            assert (folder / name).stat().st_size > 0, name


def test_the_preview_is_as_wide_as_asked(designed: tuple[Path, Recorder]) -> None:
    with Image.open(designed[0] / "preview.png") as picture:
        assert picture.width == 320


def test_each_fluid_is_one_part_from_inlet_to_outlet(designed: tuple[Path, Recorder]) -> None:
    report = json.loads((designed[0] / "report.json").read_text())
    for fluid in report["fluids"].values():
        assert fluid["components"] == 1
        assert fluid["inlet_to_outlet_connected"]
        assert 0 < fluid["passage_m"] < 0.04
    assert report["leak_free"]
    assert report["trapped_volume_m3"] == 0


def test_solid_and_fluids_from_the_files_fill_the_envelope(designed: tuple[Path, Recorder]) -> None:
    folder, _ = designed
    meshes = [read_domain_mesh(folder / f"{name}.stl", Unit.MM) for name in ("solid", "fluid_hot", "fluid_cold")]
    assert sum(m.volume_m3 for m in meshes) * 1e9 == pytest.approx(VOLUME, rel=1e-4)


@pytest.mark.parametrize("name", ["solid", "fluid_hot", "fluid_cold"])
def test_a_reader_that_joins_vertices_finds_the_file_closed(designed: tuple[Path, Recorder], name: str) -> None:
    mesh = trimesh.load(designed[0] / f"{name}.stl")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent


def test_the_3mf_holds_the_solid_in_its_unit(designed: tuple[Path, Recorder]) -> None:
    solid = read_domain_mesh(designed[0] / "solid.3mf", None)
    stl = read_domain_mesh(designed[0] / "solid.stl", Unit.MM)
    assert solid.units == Unit.MM
    assert solid.volume_m3 == pytest.approx(stl.volume_m3, rel=1e-5)


def test_the_field_s_file_is_zero_on_the_surface_and_signed_in_the_fluids(designed: tuple[Path, Recorder]) -> None:
    folder, _ = designed
    field = read_field(folder / "field.safetensors")
    assert field.units == Unit.MM
    vertices = trimesh.load(folder / "surface.stl").vertices
    off = np.abs(field.value(vertices)) / np.linalg.norm(field.gradient(vertices), axis=1)
    voxel = 80 / 64  # of the surface: between its voxels marching cubes is linear, the field is not
    assert np.quantile(off, 0.99) < 0.1 * voxel
    assert off.max() < 0.5 * voxel
    for name, sign in (("fluid_hot", 1), ("fluid_cold", -1)):
        fluid = trimesh.load(folder / f"{name}.stl")
        assert (sign * field.value(fluid.vertices) > 0).mean() > 0.999


def test_the_readme_s_example_of_the_field_runs(
    designed: tuple[Path, Recorder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", readme, re.S)
    (tmp_path / "result").symlink_to(designed[0])
    monkeypatch.chdir(tmp_path)
    named: dict[str, Any] = {}
    exec(compile(example, "README.md", "exec"), named)
    value, gradient = named["field"].value(named["points"]), named["field"].gradient(named["points"])
    assert value.shape == (2,)
    assert gradient.shape == (2, 3)
    assert capsys.readouterr().out == f"{value}\n{gradient}\n"


def test_regions_hold_the_patches_triangles(designed: tuple[Path, Recorder]) -> None:
    folder, _ = designed
    document = json.loads((folder / "patches.json").read_text())
    for fluid in ("hot", "cold"):
        text = gzip.decompress((folder / document[fluid]["regions"]).read_bytes()).decode()
        counts = {
            name: part.count("endfacet")
            for name, part in re.findall(r"^solid (\S+)\n(.*?)^endsolid", text, re.M | re.S)
        }
        listed = {p["name"]: sum(b - a for a, b in p["triangles"]) for p in document[fluid]["patches"]}
        assert counts == listed


def test_patches_cover_each_fluids_boundary_once(designed: tuple[Path, Recorder]) -> None:
    folder, _ = designed
    document = json.loads((folder / "patches.json").read_text())
    for fluid in ("hot", "cold"):
        mesh = trimesh.load(folder / document[fluid]["file"], process=False)
        ranges = sorted(run for patch in document[fluid]["patches"] for run in patch["triangles"])
        assert ranges[0][0] == 0
        assert ranges[-1][1] == len(mesh.faces)
        assert all(a[1] == b[0] for a, b in pairwise(ranges))
        names = [patch["name"] for patch in document[fluid]["patches"]]
        assert {"interface", "inlet-0", "outlet-0"} <= set(names)


def test_progress_names_every_stage_and_does_not_go_back(designed: tuple[Path, Recorder]) -> None:
    reports = designed[1].reports
    stages = [stage for step in ("prepare", "solve", "build") for stage in STAGES[step]]
    seen = list(dict.fromkeys(stage for stage, _ in reports))
    assert seen == stages
    for stage in stages:
        fractions = [f for s, f in reports if s == stage]
        assert max(fractions) == 1
        # A stage may consist of two runs of the stopwatch: it starts again at 0 at most once.
        assert sum(b < a for a, b in pairwise(fractions)) <= 1


def test_requirements_are_lines_of_the_certificate(designed: tuple[Path, Recorder]) -> None:
    report = json.loads((designed[0] / "report.json").read_text())
    required = {c["name"]: c["passed"] for c in report["certificate"] if c["name"].startswith("required")}
    assert required == {"required: narrowest passage, m": True, "required: overhang share": False}
    assert not report["certified"]
    assert report["best_build_direction"]["overhang_area_fraction"] <= report["overhang_area_fraction"]


def test_the_page_is_self_contained(designed: tuple[Path, Recorder]) -> None:
    page = (designed[0] / "report.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert "http://" not in page
    assert "https://" not in page


@pytest.mark.slow
def test_the_same_request_gives_the_same_bytes(designed: tuple[Path, Recorder], tmp_path: Path) -> None:
    first = designed[0]
    spec = json.loads((first / "report.json").read_text())["provenance"]["spec"]
    (tmp_path / "run.py").write_text(
        "import json, sys; from pathlib import Path\n"
        "from dualms.pipeline import run_step; from dualms.progress import Silent; from dualms.spec import Spec\n"
        "folder = Path(sys.argv[1]); spec = Spec.model_validate(json.loads(sys.argv[2]))\n"
        "[run_step(s, folder, folder / 'box.stl', spec, Silent()) for s in ('prepare', 'solve', 'build')]\n"
    )
    _domain_file(tmp_path)
    subprocess.run([sys.executable, tmp_path / "run.py", tmp_path, json.dumps(spec)], check=True)
    for step in ("prepare", "solve", "build"):
        for name in ARTIFACTS[step]:
            if not name.startswith("report"):  # holds timings
                assert (tmp_path / name).read_bytes() == (first / name).read_bytes(), name


def test_a_cancelled_design_stops() -> None:
    class Impatient:
        def report(self, stage: str, fraction: float, note: str = "") -> None:
            raise Cancelled

    with pytest.raises(Cancelled):
        run_step("prepare", Path("."), Path("nowhere.stl"), small_spec(end_ports()), Impatient())


def test_a_changed_wall_changes_the_keys_of_build_alone() -> None:
    one, two = (step_keys("0" * 64, small_spec(end_ports(), wall={"thickness": t})) for t in (0.8, 0.9))
    assert one["prepare"] == two["prepare"]
    assert one["solve"] == two["solve"]
    assert one["build"] != two["build"]


def test_other_formats_change_the_keys_of_build_alone() -> None:
    one, two = (step_keys("0" * 64, small_spec(end_ports(), output={"formats": f})) for f in ([], ["obj"]))
    assert one["solve"] == two["solve"]
    assert one["build"] != two["build"]


def test_a_changed_header_changes_the_keys_of_build_alone() -> None:
    fluids = [with_headers(end_ports(), {"radius": 6, "length": n}) for n in (20, 21)]
    one, two = (step_keys("0" * 64, small_spec(f)) for f in fluids)
    bare = step_keys("0" * 64, small_spec(end_ports()))
    assert one["solve"] == two["solve"] == bare["solve"]
    assert len({one["build"], two["build"], bare["build"]}) == 3


@pytest.mark.slow
def test_headers_an_outer_shell_and_a_graded_wall_are_built(tmp_path: Path) -> None:
    spec = small_spec(
        with_headers(end_ports(), {"radius": 6, "length": 20, "flange": {"radius": 10, "thickness": 3}}),
        shell={"thickness": 1.5, "side": "outside"},
        wall={"graded": {"direction": (1, 0, 0), "stations": [(0, 0.8), (80, 1.4)]}},
        output={"formats": ["obj", "vtu"]},
    )
    for step in steps_of(spec):
        run_step(step, tmp_path, _domain_file(tmp_path), spec, Silent())
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["leak_free"]
    assert all(report["watertight"].values())
    assert report["volume_closure_error"] < 1e-5  # single precision
    assert 0.0008 < report["wall"]["thickness_m"] < 0.0014
    mesh = read_domain_mesh(tmp_path / "solid.stl", Unit.MM)
    assert np.ptp(mesh.vertices_m, axis=0)[0] == pytest.approx(0.080 + 2 * 0.0215, abs=1e-6)
    files = report["provenance"]["files_sha256"]
    for name in OPTIONAL_ARTIFACTS["build"]:
        assert files[name] == sha256_of(tmp_path / name)
    document = json.loads((tmp_path / "patches.json").read_text())
    ports = [p for f in ("hot", "cold") for p in document[f]["patches"] if "let" in p["name"]]
    assert len(ports) == 4
    for port in ports:
        assert port["area_m2"] == pytest.approx(np.pi * 0.006**2, rel=1e-3)


def test_a_changed_seed_changes_every_key() -> None:
    one, two = (step_keys("0" * 64, small_spec(end_ports(), seed=s)) for s in (0, 1))
    assert not set(one.values()) & set(two.values())


def test_skeleton_sites_lie_in_the_box(designed: tuple[Path, Recorder]) -> None:
    document = json.loads((designed[0] / "skeletons.json").read_text())
    sites = np.array(document["sites"])
    assert len(sites) == len(document["labels"]) == 60
    assert (sites > 0).all()
    assert (sites < [0.08, 0.06, 0.04]).all()


def test_the_scene_holds_the_skeletons_in_metres(designed: tuple[Path, Recorder]) -> None:
    scene = trimesh.load_scene(designed[0] / "scene.glb")
    assert {"skeleton_hot", "skeleton_cold", "cut_edges"} <= set(scene.geometry)
    low, high = scene.geometry["solid"].bounds
    for name in ("skeleton_hot", "skeleton_cold"):
        bones = scene.geometry[name].bounds
        assert (bones[0] > low - 1e-3).all()
        assert (bones[1] < high + 1e-3).all()
