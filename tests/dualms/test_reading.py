"""Reading of envelopes: what comes in is exact, and what is unsound is refused with its code."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dualms.errors import DualMSError, InvalidMesh, MissingUnits, TooLarge, UnreadableFile, UnsupportedFormat
from dualms.reading import inspect_file, read_domain_mesh
from dualms.spec import Unit
from tests.dualms.shapes import written


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off", ".glb", ".3mf"])
def test_a_box_keeps_its_volume_in_every_format(tmp_path: Path, suffix: str) -> None:
    mesh = read_domain_mesh(written(trimesh.creation.box((4, 3, 2)), tmp_path / f"box{suffix}"), Unit.CM)
    assert mesh.volume_m3 == pytest.approx(24e-6, rel=1e-6)
    assert len(mesh.faces) == 12


def test_text_and_binary_stl_give_the_same_mesh(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(2)
    (tmp_path / "text.stl").write_text(trimesh.exchange.stl.export_stl_ascii(sphere))
    text = read_domain_mesh(tmp_path / "text.stl", Unit.MM)
    binary = read_domain_mesh(written(sphere, tmp_path / "binary.stl"), Unit.MM)
    assert text.volume_m3 == pytest.approx(binary.volume_m3, rel=1e-6)
    assert len(text.faces) == len(binary.faces) == len(sphere.faces)


def test_units_scale_lengths(tmp_path: Path) -> None:
    path = written(trimesh.creation.box((1, 1, 1)), tmp_path / "box.stl")
    volumes = [read_domain_mesh(path, unit).volume_m3 for unit in (Unit.M, Unit.CM, Unit.MM, Unit.IN)]
    np.testing.assert_allclose(volumes, [1, 1e-6, 1e-9, 0.0254**3], rtol=1e-9)


def test_units_are_required_where_the_format_carries_none(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 1, 1))
    with pytest.raises(MissingUnits):
        read_domain_mesh(written(box, tmp_path / "box.stl"), None)
    assert read_domain_mesh(written(box, tmp_path / "box.glb"), None).units == Unit.M


def test_a_box_has_six_facets_and_a_cylinder_two(tmp_path: Path) -> None:
    box = inspect_file(written(trimesh.creation.box((4, 3, 2)), tmp_path / "box.stl"), Unit.MM)
    assert [round(f.area, 6) for f in box.facets] == [12, 12, 8, 8, 6, 6]
    cylinder = inspect_file(written(trimesh.creation.cylinder(1, 3, sections=48), tmp_path / "c.stl"), Unit.MM)
    assert sorted(f.normal[2] for f in cylinder.facets) == [-1, 1]


def test_a_step_part_is_read_in_its_own_unit(tmp_path: Path) -> None:
    part = Path(__file__).parent / "data" / "annulus_block.step"  # 80 x 50 x 40 mm with a bore of 16 mm
    expected = 80 * 50 * 40 - np.pi * 8**2 * 40
    for units in (None, Unit.MM, Unit.IN):
        found = inspect_file(part, units)
        assert found.volume * found.units.metres**3 * 1e9 == pytest.approx(expected, rel=1e-3)
        assert max(found.bounds[1]) * found.units.metres == pytest.approx(0.08, rel=1e-6)
    assert len(inspect_file(part, None).facets) == 6
    with pytest.raises(UnreadableFile):
        read_domain_mesh(_bytes(tmp_path / "text.step", b"solid nothing"), None)


def _bytes(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def _open_box(folder: Path) -> Path:
    box = trimesh.creation.box((1, 1, 1))
    return written(trimesh.Trimesh(box.vertices, box.faces[:-1], process=False), folder / "open.stl")


def _two_boxes(folder: Path) -> Path:
    boxes = [trimesh.creation.box((1, 1, 1)).apply_translation((k, 0, 0)) for k in (0, 3)]
    return written(trimesh.util.concatenate(boxes), folder / "two.stl")


def _one_face_flipped(folder: Path) -> Path:
    box = trimesh.creation.box((1, 1, 1))
    faces = box.faces.copy()
    faces[0] = faces[0, ::-1]
    return written(trimesh.Trimesh(box.vertices, faces, process=False), folder / "flipped.stl")


def _inside_out(folder: Path) -> Path:
    box = trimesh.creation.box((1, 1, 1))
    return written(trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False), folder / "inward.stl")


def _not_a_number(folder: Path) -> Path:
    box = trimesh.creation.box((1, 1, 1))
    content = bytearray(box.export(file_type="stl"))
    content[84 + 12 : 84 + 16] = struct.pack("<f", float("nan"))
    return _bytes(folder / "nan.stl", bytes(content))


def _forged_count(folder: Path) -> Path:
    content = bytearray(trimesh.creation.box((1, 1, 1)).export(file_type="stl"))
    content[80:84] = struct.pack("<I", 4_000_000_000)
    return _bytes(folder / "forged.stl", bytes(content))


def _bomb(folder: Path) -> Path:
    path = folder / "bomb.3mf"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(6):
            archive.writestr(f"3D/{k}.model", b"\0" * 100_000_000)
    return path


def _flat(folder: Path) -> Path:
    return written(trimesh.creation.box((1, 1, 1e-9)), folder / "flat.stl")


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (_open_box, InvalidMesh),
        (_two_boxes, InvalidMesh),
        (_one_face_flipped, InvalidMesh),
        (_inside_out, InvalidMesh),
        (_not_a_number, InvalidMesh),
        (_flat, InvalidMesh),
        (_forged_count, UnreadableFile),
        (_bomb, TooLarge),
        (lambda f: _bytes(f / "empty.stl", b""), UnreadableFile),
        (lambda f: _bytes(f / "prose.stl", b"solid my heart\nand nothing else\n"), UnreadableFile),
        (lambda f: _bytes(f / "zeros.stl", b"\0" * 2_000_000), UnreadableFile),
        (
            lambda f: _bytes(f / "cut.glb", trimesh.creation.box((1, 1, 1)).export(file_type="glb")[:400]),
            UnreadableFile,
        ),
        (lambda f: _bytes(f / "really.obj", trimesh.creation.box((1, 1, 1)).export(file_type="glb")), UnreadableFile),
        (lambda f: _bytes(f / "really.3mf", b"not an archive at all"), UnreadableFile),
        (lambda f: _bytes(f / "part.iges", b"1"), UnsupportedFormat),
        (lambda f: _bytes(f / "part.step", b"ISO-10303-21;"), UnreadableFile),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_an_unsound_file_is_refused_with_advice(tmp_path: Path, make, error: type[DualMSError]) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(error) as refused:
        read_domain_mesh(make(tmp_path), Unit.MM)
    assert refused.value.advice
    assert "Traceback" not in str(refused.value)


def test_the_face_cap_is_told_before_loading(tmp_path: Path) -> None:
    path = written(trimesh.creation.icosphere(3), tmp_path / "sphere.stl")
    with pytest.raises(TooLarge, match="1,280"):
        read_domain_mesh(path, Unit.MM, max_faces=1000)


def test_an_open_mesh_is_told_where(tmp_path: Path) -> None:
    with pytest.raises(InvalidMesh, match=r"3 edges belong to one triangle only, first near \["):
        read_domain_mesh(_open_box(tmp_path), Unit.MM)
