"""Bad inputs: each is refused with a stable code and advice, leaves no file, and the service goes on."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest
import trimesh

if TYPE_CHECKING:
    from conftest import Served


def stl(mesh: trimesh.Trimesh) -> bytes:
    return mesh.export(file_type="stl")


def box_mesh() -> trimesh.Trimesh:
    return trimesh.creation.box((40, 30, 20))


def open_mesh() -> bytes:
    mesh = box_mesh()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    return stl(mesh)


def two_bodies() -> bytes:
    other = box_mesh()
    other.apply_translation((100, 0, 0))
    return stl(trimesh.util.concatenate([box_mesh(), other]))


def inside_out() -> bytes:
    mesh = box_mesh()
    mesh.invert()
    return stl(mesh)


def one_flipped_face() -> bytes:
    mesh = box_mesh()
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    return stl(trimesh.Trimesh(mesh.vertices, faces, process=False))


def not_a_number() -> bytes:
    data = bytearray(stl(box_mesh()))
    data[96:100] = struct.pack("<f", float("nan"))
    return bytes(data)


def forged_count() -> bytes:
    data = bytearray(stl(box_mesh()))
    data[80:84] = struct.pack("<I", 0xFFFFFFFF)
    return bytes(data)


def flat_sheet() -> bytes:
    return stl(trimesh.creation.box((40, 30, 1e-9)))


def zip_bomb() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("3D/3dmodel.model", "w", force_zip64=True) as member:
            for _ in range(520):
                member.write(bytes(1024**2))
        archive.writestr("[Content_Types].xml", "<Types/>")
    return buffer.getvalue()


def truncated_glb() -> bytes:
    return box_mesh().export(file_type="glb")[:-200]


def entity_bomb() -> bytes:
    entities = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
    model = f'<?xml version="1.0"?><!DOCTYPE m [<!ENTITY a0 "aaaaaaaaaa">{entities}]><model>&a11;</model>'
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", model)
    return buffer.getvalue()


def obj_of_huge_indices() -> bytes:
    return b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4000000000\n"


FILES: dict[str, tuple[str, Callable[[], bytes], int, str]] = {
    "open mesh": ("a.stl", open_mesh, 422, "invalid-mesh"),
    "two bodies": ("a.stl", two_bodies, 422, "invalid-mesh"),
    "inside out": ("a.stl", inside_out, 422, "invalid-mesh"),
    "one face flipped": ("a.stl", one_flipped_face, 422, "invalid-mesh"),
    "not a number": ("a.stl", not_a_number, 422, "invalid-mesh"),
    "flat": ("a.stl", flat_sheet, 422, "invalid-mesh"),
    "empty": ("a.stl", lambda: b"", 422, "unreadable-file"),
    "unknown extension": ("a.exe", lambda: stl(box_mesh()), 415, "unsupported-format"),
    "no extension": ("stl", lambda: stl(box_mesh()), 415, "unsupported-format"),
    "extension of another format": ("a.glb", lambda: stl(box_mesh()), 422, "unreadable-file"),
    "text as STL": ("a.stl", lambda: b"Dear printer, please print a heat exchanger. " * 9, 422, "unreadable-file"),
    "ASCII STL without triangles": ("a.stl", lambda: b"solid nothing\nendsolid nothing\n", 422, "unreadable-file"),
    "forged face count": ("a.stl", forged_count, 422, "unreadable-file"),
    "truncated GLB": ("a.glb", truncated_glb, 422, "unreadable-file"),
    "ZIP bomb as 3MF": ("a.3mf", zip_bomb, 413, "too-large"),
    "entity bomb as 3MF": ("a.3mf", entity_bomb, 422, "unreadable-file"),
    "OBJ with forged indices": ("a.obj", obj_of_huge_indices, 422, "unreadable-file"),
    "PLY with a forged count": (
        "a.ply",
        lambda: (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n" + bytes(64)
        ),
        422,
        "unreadable-file",
    ),
}


def change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Set a field of the specification, named by a path with dots."""

    def apply(spec: dict[str, Any]) -> None:
        *folders, last = path.split(".")
        here: Any = spec
        for part in folders:
            here = here[int(part)] if part.isdigit() else here.setdefault(part, {})
        here[int(last) if last.isdigit() else last] = value

    return apply


# Refused at submission: change to a good specification, code, what the detail must name.
SPECS: dict[str, tuple[Callable[[dict[str, Any]], None], str, str]] = {
    "unknown key": (change("wal", {"thickness": 1}), "invalid-request", "spec.wal"),
    "unknown nested key": (change("graph.points", 3), "invalid-request", "spec.graph.points"),
    "too few sites": (change("graph.sites", 3), "invalid-request", "spec.graph.sites"),
    "negative radius": (change("fluids.hot.inlets.0.radius", -1), "invalid-request", "spec.fluids.hot.inlets.0"),
    "no outlets": (change("fluids.cold.outlets", []), "invalid-request", "spec.fluids.cold.outlets"),
    "not a number": (change("seed", "zero"), "invalid-request", "spec.seed"),
    "zero direction": (change("flow", {"kind": "direction", "vector": [0, 0, 0]}), "invalid-request", "spec.flow"),
    "unknown method": (change("field", {"method": "magic"}), "invalid-request", "spec.field"),
    "wall thicker than the domain": (change("wall.thickness", 100), "wall-too-thick", "20"),
    "port far off the domain": (change("fluids.hot.inlets.0.center", [99, 0, 0]), "port-not-on-boundary", "79"),
    "facet that is not there": (change("fluids.hot.inlets.0", {"facet": 6}), "port-not-on-boundary", "6 planar"),
    "units against the domain's": (change("units", "cm"), "invalid-spec", "mm"),
    "evaluation without a solver": (change("evaluation", {}), "evaluation-unavailable", "flow"),
}

# Found by the first step, which has the mesh.
JOBS: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "port inside the domain": (change("fluids.hot.inlets.0.center", [0, 0, 0]), "port-not-on-boundary"),
    "ports that overlap": (change("fluids.cold.inlets.0.center", [20, -3, 0]), "overlapping-ports"),
}


@pytest.fixture(autouse=True)
def nothing_left_and_still_serving(served: Served) -> Iterator[None]:
    def files() -> set[Path]:
        folders = (served.data / "artifacts", served.data / "scratch")
        return {p.relative_to(served.data) for f in folders for p in f.rglob("*") if p.is_file()}

    before = files()
    yield
    assert not files() - before
    assert served.http.get("/healthz").status_code == 200
    assert served.process.poll() is None


def refused(answer: httpx.Response, status: int, code: str) -> dict[str, Any]:
    """The problem document, checked."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = answer.json()
    assert (problem["status"], problem["code"], problem["type"]) == (status, code, f"urn:dualms:problem:{code}")
    assert set(problem) == {"type", "title", "status", "detail", "code", "advice", "measured", "errors"}
    assert problem["title"]
    assert problem["detail"]
    assert problem["advice"]
    for leak in ("Traceback", "site-packages", '.py"', str(Path.home()), "/tmp"):
        assert leak not in answer.text
    return problem


@pytest.mark.parametrize("case", FILES)
def test_bad_file_is_refused(served: Served, tmp_path: Path, case: str) -> None:
    name, make, status, code = FILES[case]
    (tmp_path / name).write_bytes(make())
    refused(served.upload(tmp_path / name), status, code)


def test_200_megabytes_of_zeros_are_refused(served: Served, tmp_path: Path) -> None:
    with (tmp_path / "zeros.stl").open("wb") as file:
        file.truncate(200_000_000)
    refused(served.upload(tmp_path / "zeros.stl"), 422, "unreadable-file")


def test_missing_units_are_refused(served: Served, tmp_path: Path) -> None:
    (tmp_path / "cone.stl").write_bytes(stl(trimesh.creation.cone(10, 20)))
    refused(served.upload(tmp_path / "cone.stl", units=None), 422, "missing-units")


def test_units_that_are_none_are_refused_with_the_field(served: Served, box: Path) -> None:
    problem = refused(served.upload(box, "furlong"), 422, "invalid-request")
    assert problem["errors"][0]["field"] == "units"


@pytest.mark.parametrize("case", SPECS)
def test_bad_specification_is_refused_at_submission(
    served: Served, domain_id: str, spec: dict[str, Any], case: str
) -> None:
    apply, code, named = SPECS[case]
    apply(spec)
    answer = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec})
    problem = refused(answer, 422, code)
    assert named in problem["detail"]


@pytest.mark.parametrize("case", JOBS)
def test_what_only_the_mesh_tells_is_a_failed_design_with_a_code(
    served: Served, domain_id: str, spec: dict[str, Any], made: dict[str, Any], case: str
) -> None:
    apply, code = JOBS[case]
    apply(spec)
    answer = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec})
    assert answer.status_code == 202, answer.text
    ended = served.ended(answer.json()["id"])
    assert (ended["status"], ended["error"]["code"]) == ("failed", code)
    assert ended["error"]["detail"]
    assert ended["error"]["advice"]
    assert "Traceback" not in json.dumps(ended)


@pytest.fixture(scope="module")
def dumbbell(served: Served, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Two boxes joined by a hair: a good domain that no coarse grid sees as one."""
    left, right = box_mesh(), box_mesh()
    left.apply_translation((-30, 0, 0))
    right.apply_translation((30, 0, 0))
    joined = trimesh.boolean.union([left, right, trimesh.creation.box((30, 0.05, 0.05))], engine="manifold")
    path = tmp_path_factory.mktemp("dumbbell") / "dumbbell.stl"
    path.write_bytes(stl(joined))
    return str(served.upload(path).json()["id"])


def test_fluids_that_cannot_meet_their_outlets_are_a_failed_design(
    served: Served, dumbbell: str, spec: dict[str, Any]
) -> None:
    for fluid in spec["fluids"].values():
        for port in (*fluid["inlets"], *fluid["outlets"]):
            port["center"][0] *= 2.5
    answer = served.http.post("/v1/designs", json={"domain": dumbbell, "spec": spec})
    assert answer.status_code == 202, answer.text
    ended = served.ended(answer.json()["id"])
    assert (ended["status"], ended["error"]["code"]) == ("failed", "disconnected-domain")


BODIES: dict[str, tuple[dict[str, Any], int, str]] = {
    "no JSON": ({"content": b"{", "headers": {"content-type": "application/json"}}, 400, "malformed-request"),
    "NaN": ({"content": b'{"spec": NaN}', "headers": {"content-type": "application/json"}}, 400, "malformed-request"),
    "deep JSON": ({"content": b"[" * 9999, "headers": {"content-type": "application/json"}}, 400, "malformed-request"),
    "not UTF-8": ({"content": b'"\xff"', "headers": {"content-type": "application/json"}}, 400, "malformed-request"),
    "a list": ({"json": []}, 422, "invalid-request"),
    "empty object": ({"json": {}}, 422, "invalid-request"),
    "no body": ({}, 415, "unsupported-media-type"),
    "XML": ({"content": b"<a/>", "headers": {"content-type": "text/xml"}}, 415, "unsupported-media-type"),
    "too large": ({"json": {"spec": "x" * 2_000_000}}, 413, "too-large"),
    "form without file": ({"files": {"spec": (None, "{}")}}, 422, "invalid-request"),
    "form without spec": ({"files": {"domain": ("a.stl", b"x")}}, 422, "invalid-request"),
    "form with a stray field": ({"files": {"domain": ("a.stl", b"x"), "color": (None, "red")}}, 422, "invalid-request"),
    "broken form": (
        {"content": b"--x\r\n\r\n", "headers": {"content-type": "multipart/form-data"}},
        400,
        "malformed-request",
    ),
}


@pytest.mark.parametrize("case", BODIES)
def test_bad_body_is_refused(served: Served, case: str) -> None:
    options, status, code = BODIES[case]
    refused(served.http.post("/v1/designs", **options), status, code)


def test_body_without_a_length_is_counted_as_it_comes(served: Served) -> None:
    def endless() -> Iterator[bytes]:
        for _ in range(64):
            yield b"x" * 65536

    headers = {"content-type": "application/json"}
    refused(served.http.post("/v1/designs", content=endless(), headers=headers), 413, "too-large")


@pytest.mark.parametrize("form", [{}, {"units": "mm"}, {"sha256": "0" * 64, "file": "both"}])
def test_a_domain_s_form_has_a_file_or_a_hash(served: Served, box: Path, form: dict[str, str]) -> None:
    files = {"file": ("box.stl", box.read_bytes())} if form.pop("file", None) else {"units": (None, "mm")}
    problem = refused(served.http.post("/v1/domains", data=form, files=files), 422, "invalid-request")
    assert problem["errors"][0]["field"] == "file"


def test_unknown_domain_is_refused(served: Served, spec: dict[str, Any]) -> None:
    answer = served.http.post("/v1/designs", json={"domain": "0" * 64, "spec": spec})
    refused(answer, 404, "domain-not-found")


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/v1/nothing", 404, "not-found"),
        ("GET", "/v1/designs/" + "0" * 32, 404, "design-not-found"),
        ("GET", "/v1/designs/..%2f..%2fetc%2fpasswd", 404, "not-found"),
        ("GET", "/v1/designs/x", 422, "invalid-request"),
        ("GET", "/v1/designs/" + "0" * 32 + "/artifacts/solid.stl", 404, "design-not-found"),
        ("GET", "/v1/designs/" + "0" * 32 + "/events", 404, "design-not-found"),
        ("POST", "/v1/designs/" + "0" * 32 + "/cancel", 404, "design-not-found"),
        ("DELETE", "/v1/designs/" + "0" * 32, 404, "design-not-found"),
        ("GET", "/v1/domains/" + "0" * 64, 404, "domain-not-found"),
        ("GET", "/v1/designs?limit=0", 422, "invalid-request"),
        ("GET", "/v1/designs?cursor=x", 422, "invalid-request"),
        ("GET", "/v1/designs?status=lost", 422, "invalid-request"),
        ("GET", "/v1/designs?created_after=yesterday", 422, "invalid-request"),
        ("GET", "/v1/designs?created_after=0.5", 422, "invalid-request"),
        ("GET", "/v1/designs?created_before=2026-01-01T00:00:00", 422, "invalid-request"),
        ("GET", "/v1/domains?cursor=x", 422, "invalid-request"),
        ("DELETE", "/v1/domains/" + "0" * 64, 404, "domain-not-found"),
        ("PATCH", "/v1/designs", 405, "method-not-allowed"),
        ("POST", "/healthz", 405, "method-not-allowed"),
    ],
)
def test_bad_address_is_refused(served: Served, method: str, path: str, status: int, code: str) -> None:
    refused(served.http.request(method, path), status, code)


def test_a_refused_method_names_all_that_are_allowed(served: Served) -> None:
    answer = served.http.patch("/v1/designs/" + "0" * 32)
    assert (answer.status_code, answer.headers["allow"]) == (405, "DELETE, GET")


def test_an_artifact_that_is_not_there_is_refused(served: Served, domain_id: str, spec: dict[str, Any]) -> None:
    spec["fluids"]["hot"]["inlets"][0]["center"] = [0, 0, 0]
    design = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec}).json()
    served.ended(design["id"])
    refused(served.http.get(f"{design['href']}/artifacts/solid.stl"), 404, "artifact-not-found")
    refused(served.http.get(f"{design['href']}/artifacts/prepared.safetensors"), 404, "artifact-not-found")


@pytest.mark.parametrize("key", ["", "x" * 256])
def test_bad_idempotency_key_is_refused(served: Served, domain_id: str, spec: dict[str, Any], key: str) -> None:
    body = {"domain": domain_id, "spec": spec}
    refused(served.http.post("/v1/designs", json=body, headers={"Idempotency-Key": key}), 400, "malformed-request")
