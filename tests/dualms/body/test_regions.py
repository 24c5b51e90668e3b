"""Patches as regions of one STL: the fluid's own triangles, named as in patches.json, and sound to OpenFOAM."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from dualms.body.body import Fluid, in_units
from dualms.body.regions import write_regions
from dualms.cfd.openfoam import find_openfoam
from tests.dualms.bodies import gyroid_body


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
def test_openfoam_finds_every_region_on_one_closed_surface(fluids: dict[str, Fluid], side: str, tmp_path: Path) -> None:
    foam = find_openfoam()
    if foam is None or not (foam.programs / "surfaceCheck").exists():
        pytest.skip("OpenFOAM's surfaceCheck is not installed")
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
