"""Every format read back by another reader: the same size and volume in metres, and figures where they belong."""

from __future__ import annotations

import locale
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import trimesh

from dualms.body.body import Body, in_units
from dualms.body.files import HOT, SIDE_COLOURS, write_3mf, write_glb, write_stl
from dualms.exchange import write_formats, write_obj, write_vtu
from dualms.reading import read_domain_mesh
from dualms.spec import Unit
from dualms.steps import OPTIONAL_ARTIFACTS
from tests.dualms.bodies import WALL, flat_body, gyroid_body

LONGEST_M = 0.08


def _solid(path: Path) -> trimesh.Trimesh:
    if path.suffix == ".vtu":
        mesh = meshio.read(path)
        return trimesh.Trimesh(mesh.points, mesh.cells_dict["triangle"], process=False)
    return trimesh.load_mesh(path)


WRITERS: dict[str, Callable[[Body, Unit, Path], None]] = {
    ".stl": lambda body, units, path: write_stl(body.solid, path),
    ".3mf": lambda body, units, path: write_3mf(body.solid, body.solid_side, units, path),
    ".obj": lambda body, units, path: write_obj(body.solid, units, path),
    ".vtu": lambda body, units, path: write_vtu(body.solid, {}, {"side": body.solid_side}, path),
}


@pytest.mark.parametrize("units", list(Unit))
@pytest.mark.parametrize("suffix", WRITERS)
def test_a_file_in_the_models_unit_has_the_bodys_size(suffix: str, units: Unit, tmp_path: Path) -> None:
    body = flat_body(units)
    WRITERS[suffix](in_units(body, units.metres), units, tmp_path / f"solid{suffix}")
    read = _solid(tmp_path / f"solid{suffix}")
    assert read.is_watertight
    assert np.ptp(read.vertices, axis=0) * units.metres == pytest.approx([0.08, 0.06, 0.04], rel=1e-6)
    assert read.volume * units.metres**3 == pytest.approx(body.solid.volume, rel=1e-5)
    assert len(read.faces) == len(body.solid.faces)


def test_a_3mf_says_its_unit_itself(tmp_path: Path) -> None:
    for units in Unit:
        body = flat_body(units)
        scaled = in_units(body, units.metres)
        write_3mf(scaled.solid, scaled.solid_side, units, tmp_path / "solid.3mf")
        assert read_domain_mesh(tmp_path / "solid.3mf", None).volume_m3 == pytest.approx(body.solid.volume, rel=1e-5)


def test_a_3mf_s_triangles_have_the_colours_of_their_sides(tmp_path: Path) -> None:
    scaled = in_units(flat_body(Unit.MM), 1e-3)
    write_3mf(scaled.solid, scaled.solid_side, Unit.MM, tmp_path / "solid.3mf")
    with zipfile.ZipFile(tmp_path / "solid.3mf") as archive:
        model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
    assert model.attrib["unit"] == "millimeter"
    group = model.find(".//{*}colorgroup")
    assert group is not None
    colours = [tuple(bytes.fromhex(colour.attrib["color"][1:])) for colour in group]
    shown = [colours[int(t.attrib["p1"])] for t in model.findall(".//{*}triangle") if t.get("pid") == group.get("id")]
    # Triangles of the object's own colour may leave it out.
    for side in (1, -1):
        assert shown.count(SIDE_COLOURS[side]) == (scaled.solid_side == side).sum()


def test_a_scene_is_in_metres(tmp_path: Path) -> None:
    body = flat_body(Unit.MM)
    write_glb({"solid": (body.solid, HOT)}, tmp_path / "scene.glb")
    solid = trimesh.load_scene(tmp_path / "scene.glb").geometry["solid"]
    assert np.ptp(solid.vertices, axis=0) == pytest.approx([0.08, 0.06, 0.04], rel=1e-6)
    assert solid.volume == pytest.approx(body.solid.volume, rel=1e-4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The gyroid's body in millimetres, in all formats on request."""
    folder = tmp_path_factory.mktemp("formats")
    _, surface, body = gyroid_body()
    write_formats(("obj", "vtu"), folder, surface.mesh, body, Unit.MM)
    return folder


def test_the_formats_on_request_are_the_files_that_the_step_names(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == set(OPTIONAL_ARTIFACTS["build"])


def test_nothing_is_written_unasked(tmp_path: Path) -> None:
    _, surface, body = gyroid_body()
    write_formats((), tmp_path, surface.mesh, body, Unit.MM)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".obj", ".vtu"])
def test_solid_and_fluids_fill_the_box_in_each_format(folder: Path, suffix: str) -> None:
    parts = [_solid(folder / f"{name}{suffix}") for name in ("solid", "fluid_hot", "fluid_cold")]
    dropped = gyroid_body()[2].dropped_m3 * 1e9
    assert sum(part.volume for part in parts) + dropped == pytest.approx(80 * 60 * 40, rel=1e-5)


def test_an_obj_names_its_unit(folder: Path) -> None:
    assert "lengths in mm" in (folder / "solid.obj").read_text()[:200]


def test_the_walls_thickness_is_that_asked_for(folder: Path) -> None:
    wall = meshio.read(folder / "wall.vtu")
    thickness = wall.point_data["thickness_m"]
    known = np.isfinite(thickness)
    assert known.mean() > 0.5
    asked = WALL * LONGEST_M
    assert np.nanmedian(thickness) == pytest.approx(asked, rel=0.01)
    assert np.nanquantile(thickness, (0.01, 0.99)) == pytest.approx((asked, asked), rel=0.05)
    # Within the shell, 2.4 mm below the box's long sides, the wall has no thickness of its own.
    sides = (wall.points[:, 1:] < 1.5) | (wall.points[:, 1:] > np.array([60, 40]) - 1.5)
    assert not known[sides.any(axis=1)].any()


def test_the_walls_curvature_is_small_on_a_minimal_surface(folder: Path) -> None:
    curvature = meshio.read(folder / "wall.vtu").point_data["mean_curvature_per_m"]
    # The nodal gyroid of cell 40 mm is within some per cent of minimal: its principal curvatures are about 2π/cell.
    assert np.nanmedian(np.abs(curvature)) < 0.1 * 2 * np.pi / 0.04


@pytest.mark.parametrize(("name", "figure"), [("solid", "side"), ("fluid_hot", "patch"), ("fluid_cold", "patch")])
def test_triangles_carry_their_side_or_patch(folder: Path, name: str, figure: str) -> None:
    body = gyroid_body()[2]
    expected = {"solid": body.solid_side, "fluid_hot": body.hot.patch, "fluid_cold": body.cold.patch}[name]
    assert (meshio.read(folder / f"{name}.vtu").cell_data[figure][0] == expected).all()


def test_writing_leaves_the_locale_as_it_was(tmp_path: Path) -> None:
    before = locale.setlocale(locale.LC_ALL, "C.UTF-8")
    body = flat_body(Unit.MM)
    write_3mf(body.solid, body.solid_side, Unit.MM, tmp_path / "solid.3mf")
    assert locale.setlocale(locale.LC_ALL) == before
