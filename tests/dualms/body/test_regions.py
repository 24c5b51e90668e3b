"""Patches as regions of one STL: the fluid's own triangles, named as in patches.json, and sound to OpenFOAM."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from dualms.body.body import Fluid, in_units
from dualms.body.regions import write_regions
from dualms.cfd.openfoam import OpenFoam, find_openfoam
from dualms.spec import Unit
from tests.dualms.bodies import flat_body, gyroid_body
from tests.dualms.body.snappy import snappy_case


@pytest.fixture(scope="module")
def fluids() -> dict[str, Fluid]:
    """Both fluids in millimetres."""
    body = in_units(gyroid_body()[2], 1e-3)
    return {"hot": body.hot, "cold": body.cold}


def _regions(text: str) -> dict[str, np.ndarray]:
    """Corners (F, 3, 3) of each named solid."""
    found = re.findall(r"^solid (\S+)\n(.*?)^endsolid \1\n", text, re.M | re.S)
    number = r"vertex (\S+) (\S+) (\S+)"
    return {name: np.array(re.findall(number, part), dtype=float).reshape(-1, 3, 3) for name, part in found}


@pytest.mark.parametrize("side", ["hot", "cold"])
def test_regions_are_the_fluids_triangles_patch_by_patch(fluids: dict[str, Fluid], side: str, tmp_path: Path) -> None:
    fluid = fluids[side]
    write_regions(fluid, tmp_path / "x.stl.gz")
    regions = _regions(gzip.decompress((tmp_path / "x.stl.gz").read_bytes()).decode())
    assert list(regions) == ["interface", "wall", "inlet-0", "outlet-0"] == list(fluid.patches)
    for index, corners in enumerate(regions.values()):
        # Not rounded once more: what single precision holds comes back.
        given = fluid.mesh.vertices[fluid.mesh.faces[fluid.patch == index]]
        assert (np.float32(corners) == np.float32(given)).all()


def test_a_patch_without_triangles_is_left_out(fluids: dict[str, Fluid], tmp_path: Path) -> None:
    fluid = fluids["hot"]
    bare = Fluid(fluid.mesh, np.zeros(len(fluid.mesh.faces), dtype=np.int64), fluid.patches, 1, 0.0, 0)
    write_regions(bare, tmp_path / "x.stl.gz")
    assert list(_regions(gzip.decompress((tmp_path / "x.stl.gz").read_bytes()).decode())) == ["interface"]


@pytest.mark.cfd
@pytest.mark.parametrize("side", ["hot", "cold"])
def test_openfoam_finds_every_region_on_one_closed_surface(
    fluids: dict[str, Fluid], side: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # it dumps the triangles of least quality where it is started
    foam = _foam("surfaceCheck")
    fluid = fluids[side]
    write_regions(fluid, tmp_path / "x.stl.gz")
    # By the name without .gz, as a mesher's dictionary has it.
    assert foam.run("surfaceCheck", tmp_path, arguments=(str(tmp_path / "x.stl"),)) == 0
    said = (tmp_path / "log.surfaceCheck").read_text()
    counts = {name: int((fluid.patch == k).sum()) for k, name in enumerate(fluid.patches)}
    table = dict(re.findall(r"^(\S+)\t(\d+)$", said, re.M))
    assert {name: int(table[name]) for name in counts} == counts
    assert f"Triangles    : {len(fluid.mesh.faces)} in 4 region(s)" in said
    assert f"Vertices     : {len(fluid.mesh.vertices)}" in said
    assert "Surface has no illegal triangles." in said
    assert "Surface is closed. All edges connected to two faces." in said
    assert "Number of unconnected parts : 1" in said
    assert "Number of zones (connected area with consistent normal) : 1" in said


@pytest.mark.cfd
def test_openfoam_s_mesher_makes_a_mesh_with_the_same_patches(tmp_path: Path) -> None:
    foam = _foam("blockMesh", "snappyHexMesh", "checkMesh")
    fluid = in_units(flat_body(Unit.MM), 1e-3).hot
    (tmp_path / "constant" / "triSurface").mkdir(parents=True)
    write_regions(fluid, tmp_path / "constant" / "triSurface" / "hot.stl.gz")
    snappy_case(tmp_path, "hot.stl", "40.1 15.2 20.3")
    for program, arguments in (("blockMesh", ()), ("snappyHexMesh", ("-overwrite",)), ("checkMesh", ())):
        assert foam.run(program, tmp_path, arguments=arguments) == 0
    assert "Finished meshing without any errors" in (tmp_path / "log.snappyHexMesh").read_text()
    boundary = (tmp_path / "constant" / "polyMesh" / "boundary").read_text()
    faces = dict(re.findall(r"(\S+)\s*\{[^}]*nFaces\s+(\d+);", boundary))
    assert set(faces) == {f"fluid_{name}" for name in fluid.patches}
    assert all(int(count) > 20 for count in faces.values())
    checked = (tmp_path / "log.checkMesh").read_text()
    assert "Mesh OK" in checked
    volume = re.search(r"Total volume = ([\d.e+]+[\d])", checked)
    assert volume is not None
    # The edges of a duct 26 mm across are rounded at cells of 2 mm.
    assert float(volume.group(1)) == pytest.approx(fluid.mesh.volume, rel=0.02)


def _foam(*programs: str) -> OpenFoam:
    found = find_openfoam()
    if found is None or not all((found.programs / program).exists() for program in programs):
        pytest.skip(f"OpenFOAM's {', '.join(programs)} is not installed")
    return found
