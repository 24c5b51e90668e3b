"""Files made to break a reader of meshes: archives, XML, glTF, forged counts, paths, numbers that are none, sheer size.

``FILES`` names each: its extension, and what writes it. None is an envelope; a reader must refuse every one, soon and
with little memory. Large ones are written in pieces, so that making them costs little.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

import trimesh

MIB = 1 << 20
MANY = 10_000_000  # faces
Writer = Callable[[Path], None]


def _bytes(content: bytes | str) -> Writer:
    data = content.encode() if isinstance(content, str) else content
    return lambda path: path.write_bytes(data) and None


def _pieces(pieces: Callable[[], Iterable[bytes]]) -> Writer:
    def write(path: Path) -> None:
        with path.open("wb") as file:
            file.writelines(pieces())

    return write


# --- archives -----------------------------------------------------------------------------------------------------

MODEL = "3D/3dmodel.model"


def _zip(entries: Callable[[], Iterable[tuple[str, Iterable[bytes]]]]) -> Writer:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, pieces in entries():
                with archive.open(name, "w", force_zip64=True) as member:
                    for piece in pieces:
                        member.write(piece)

    return write


def model(*pieces: str) -> Writer:
    return _zip(lambda: [(MODEL, (piece.encode() for piece in pieces))])


def _zeros(mebibytes: int) -> Writer:
    return _zip(lambda: [(MODEL, (bytes(MIB) for _ in range(mebibytes)))])


def _forged_size(path: Path) -> None:
    """The directory says ten bytes; what is packed is a gibibyte."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = b"".join(packer.compress(bytes(MIB)) for _ in range(1024)) + packer.flush()
    name = MODEL.encode()
    sizes = struct.pack("<III", 0, len(packed), 10)
    local = struct.pack("<IHHHHH", 0x04034B50, 20, 0, 8, 0, 33) + sizes + struct.pack("<HH", len(name), 0) + name
    entry = struct.pack("<IHHHHHH", 0x02014B50, 20, 20, 0, 8, 0, 33) + sizes
    entry += struct.pack("<HHHHHII", len(name), 0, 0, 0, 0, 0, 0) + name
    at = len(local) + len(packed)
    path.write_bytes(local + packed + entry + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 1, 1, len(entry), at, 0))


def _one_body_named_often(path: Path) -> None:
    """Thousands of directory entries for the same packed bytes, as in overlapping ZIP bombs."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(bytes(MIB)) + packer.flush()
    sizes = struct.pack("<III", zlib.crc32(bytes(MIB)), len(packed), MIB)
    local = struct.pack("<IHHHHH", 0x04034B50, 20, 0, 8, 0, 33) + sizes + struct.pack("<HH", 1, 0) + b"x"
    entries = b""
    for i in range(20_000):
        name = f"3D/{i}.model".encode()
        entries += struct.pack("<IHHHHHH", 0x02014B50, 20, 20, 0, 8, 0, 33) + sizes
        entries += struct.pack("<HHHHHII", len(name), 0, 0, 0, 0, 0, 0) + name
    at = len(local) + len(packed)
    end = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 20_000, 20_000, len(entries), at, 0)
    path.write_bytes(local + packed + entries + end)


def _changed(write: Writer, change: Callable[[bytes], bytes]) -> Writer:
    def changed(path: Path) -> None:
        write(path)
        path.write_bytes(change(path.read_bytes()))

    return changed


ARCHIVES: dict[str, tuple[str, Writer]] = {
    "archive that unpacks to a gigabyte": (".3mf", _zeros(1024)),
    "archive that unpacks to what is just allowed": (".3mf", _zeros(511)),
    "archive with a forged size": (".3mf", _forged_size),
    "archive of one body named often": (".3mf", _one_body_named_often),
    "archive of 60,000 empty files": (".3mf", _zip(lambda: ((f"3D/{i}.model", ()) for i in range(60_000)))),
    "archive in an archive": (".3mf", _zip(lambda: [("3D/inner.zip", [b"PK\x05\x06" + bytes(18)])])),
    "archive with paths that climb": (
        ".3mf",
        _zip(lambda: [(n, [b"<model/>"]) for n in ("../../../../tmp/hostile", "/tmp/hostile", MODEL)]),
    ),
    "archive with a link": (".3mf", _zip(lambda: [(MODEL, [b"/etc/passwd"])])),
    "archive cut in the middle": (".3mf", _changed(model("<model/>"), lambda b: b[: len(b) // 2])),
    "archive with an unknown method": (
        ".3mf",
        _changed(model("<model/>"), lambda b: b.replace(b"\x08\x00", b"\x63\x00")),
    ),
    "archive said to be encrypted": (
        ".3mf",
        _changed(
            model("<model/>"),
            lambda b: b.replace(b"PK\x01\x02\x2d\x03\x2d\x00\x00", b"PK\x01\x02\x2d\x03\x2d\x00\x01"),
        ),
    ),
    "archive that begins only like one": (".3mf", _bytes(b"PK\x03\x04" + bytes(4096))),
}

# --- XML ----------------------------------------------------------------------------------------------------------

HEAD = '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
TETRAHEDRON = (
    '<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="9" y="0" z="0"/><vertex x="0" y="9" z="0"/>'
    '<vertex x="0" y="0" z="9"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/>'
    '<triangle v1="1" v2="2" v3="3"/><triangle v1="2" v2="0" v3="3"/></triangles></mesh>'
)


def _entities(depth: int, width: int) -> str:
    levels = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * width}">' for i in range(1, depth))
    return f'<!DOCTYPE model [<!ENTITY e0 "{"x" * width}">{levels}]>'


def _doubling(levels: int) -> str:
    """Each object holds the one before twice: 2 ** levels bodies."""
    objects = "".join(
        f'<object id="{i + 2}" type="model"><components><component objectid="{i + 1}"/><component objectid="{i + 1}"/>'
        "</components></object>"
        for i in range(levels)
    )
    first = f'<object id="1" type="model">{TETRAHEDRON}</object>'
    return f'{HEAD}<resources>{first}{objects}</resources><build><item objectid="{levels + 1}"/></build></model>'


def built(mesh: str, transform: str = "") -> str:
    item = f'<item objectid="1"{transform}/>'
    return f'{HEAD}<resources><object id="1" type="model">{mesh}</object></resources><build>{item}</build></model>'


def _many_triangles() -> Iterable[tuple[str, Iterable[bytes]]]:
    start, end = built(TETRAHEDRON).split('<triangle v1="2"')
    block = b'<triangle v1="0" v2="2" v3="1"/>' * 10_000
    yield MODEL, (start.encode(), *(block for _ in range(MANY // 10_000)), b'<triangle v1="2"', end.encode())


XML: dict[str, tuple[str, Writer]] = {
    "XML of a billion laughs": (".3mf", model(_entities(12, 10), f"{HEAD}&e11;</model>")),
    "XML of quadratic laughs": (
        ".3mf",
        model(f'<!DOCTYPE model [<!ENTITY e "{"x" * 100_000}">]>', HEAD, "&e;" * 100_000, "</model>"),
    ),
    "XML that reads a file": (
        ".3mf",
        model('<!DOCTYPE model [<!ENTITY e SYSTEM "file:///etc/passwd">]>', f"{HEAD}&e;</model>"),
    ),
    "XML that asks the network": (
        ".3mf",
        model('<!DOCTYPE model SYSTEM "http://127.0.0.1:9/x.dtd">', f"{HEAD}</model>"),
    ),
    "XML a million levels deep": (".3mf", model(HEAD, "<a>" * 1_000_000, "</a>" * 1_000_000, "</model>")),
    "XML with an attribute of 100 MB": (".3mf", _zip(lambda: [(MODEL, [b'<model a="', *[b"x" * MIB] * 100, b'"/>'])])),
    "XML of components that hold themselves": (
        ".3mf",
        model(
            f'{HEAD}<resources><object id="1"><components><component objectid="1"/></components></object></resources>'
            '<build><item objectid="1"/></build></model>'
        ),
    ),
    "XML of components that double 30 times": (".3mf", model(_doubling(30))),
    "XML of components that double 20 times": (".3mf", model(_doubling(20))),
    "XML with numbers that are none": (".3mf", model(built(TETRAHEDRON.replace('x="9"', 'x="nan"')))),
    "XML with a transform that is none": (
        ".3mf",
        model(built(TETRAHEDRON, ' transform="nan inf 0 0 1 0 0 0 1 0 0 0"')),
    ),
    "XML with vertices that are not there": (".3mf", model(built(TETRAHEDRON.replace('v3="3"', 'v3="4000000000"')))),
    "XML with negative vertices": (".3mf", model(built(TETRAHEDRON.replace('v3="3"', 'v3="-1"')))),
    "XML of ten million triangles": (".3mf", _zip(_many_triangles)),
}

# --- glTF ---------------------------------------------------------------------------------------------------------


def _glb(document: dict[str, object] | bytes, binary: Iterable[bytes] = (), length: int = 0) -> Writer:
    def write(path: Path) -> None:
        text = document if isinstance(document, bytes) else json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        total = 12 + len(chunks) + (8 + length if length else 0)
        with path.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, total) + chunks)
            if length:
                file.write(struct.pack("<II", length, 0x004E4942))
                file.writelines(binary)

    return write


def _scene(**changes: object) -> dict[str, object]:
    """A tetrahedron: 48 bytes of positions, 24 of indices."""
    document: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "buffers": [{"byteLength": 72}],
    }
    return document | changes


CORNERS = struct.pack("<12f", 0, 0, 0, 9, 0, 0, 0, 9, 0, 0, 0, 9)
BODY = CORNERS + struct.pack("<12H", 0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3)


def _accessors(positions: dict[str, object], indices: dict[str, object]) -> list[dict[str, object]]:
    first, second = _scene()["accessors"]  # type: ignore[misc]
    return [{**first, **positions}, {**second, **indices}]  # type: ignore[dict-item]


def _views(**changes: object) -> list[dict[str, object]]:
    first, second = _scene()["bufferViews"]  # type: ignore[misc]
    return [{**first, **changes}, second]  # type: ignore[dict-item, list-item]


def tetrahedron(**changes: object) -> Writer:
    return _glb(_scene(**changes), [BODY], 72)


def _many_indices() -> Writer:
    size = 12 * MANY
    scene = _scene(
        accessors=_accessors({}, {"componentType": 5125, "count": 3 * MANY}),
        bufferViews=[{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": size}],
        buffers=[{"byteLength": 48 + size}],
    )
    block = struct.pack("<III", 0, 2, 1) * 10_000
    return lambda path: _glb(scene, [CORNERS, *(block for _ in range(MANY // 10_000))], 48 + size)(path)


GLTF: dict[str, tuple[str, Writer]] = {
    "glTF with an accessor of nothing": (
        ".glb",
        tetrahedron(accessors=[{"componentType": 5126, "count": 4, "type": "VEC3"}, _accessors({}, {})[1]]),
    ),
    "glTF with a forged count": (".glb", tetrahedron(accessors=_accessors({}, {"count": 2**31}))),
    "glTF with a negative count": (".glb", tetrahedron(accessors=_accessors({"count": -4}, {}))),
    "glTF with a count that is a text": (".glb", tetrahedron(accessors=_accessors({"count": "4"}, {}))),
    "glTF with a view outside the buffer": (".glb", tetrahedron(bufferViews=_views(byteOffset=10**12))),
    "glTF with a view before the buffer": (".glb", tetrahedron(bufferViews=_views(byteOffset=-64))),
    "glTF with an unknown component": (".glb", tetrahedron(accessors=_accessors({"componentType": 1}, {}))),
    "glTF with a mesh that is not there": (".glb", tetrahedron(nodes=[{"mesh": 7}])),
    "glTF with nodes in a circle": (".glb", tetrahedron(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}])),
    "glTF with a matrix of no numbers": (".glb", tetrahedron(nodes=[{"mesh": 0, "matrix": [None] * 16}])),
    "glTF that reads a file": (".glb", tetrahedron(buffers=[{"byteLength": 72, "uri": "file:///etc/passwd"}])),
    "glTF that asks the network": (".glb", tetrahedron(buffers=[{"byteLength": 72, "uri": "http://127.0.0.1:9/b"}])),
    "glTF with 100,000 copies of a body": (
        ".glb",
        tetrahedron(nodes=[{"mesh": 0}] * 100_000, scenes=[{"nodes": list(range(100_000))}]),
    ),
    "glTF with numbers that are none": (".glb", _glb(_scene(), [struct.pack("<f", float("nan")) + BODY[4:]], 72)),
    "glTF of JSON that is too deep": (".glb", _glb(b'{"asset":' + b"[" * 100_000 + b"]" * 100_000 + b"}")),
    "glTF of no JSON": (".glb", _glb(b"\xff\xfe{{{{")),
    "glTF with a forged chunk": (
        ".glb",
        _changed(tetrahedron(), lambda b: b[:12] + struct.pack("<I", 0xFFFFFFF0) + b[16:]),
    ),
    "glTF of ten million triangles": (".glb", _many_indices()),
}

# --- PLY, OFF, OBJ, STL, STEP --------------------------------------------------------------------------------------


def _ply(vertices: int, faces: int, body: bytes = b"", form: str = "binary_little_endian") -> bytes:
    return (
        f"ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode() + body


def _box_stl(number: float) -> bytes:
    data = bytearray(trimesh.creation.box((40, 30, 20)).export(file_type="stl"))
    data[96:100] = struct.pack("<f", number)
    return bytes(data)


def _many(head: bytes, face: bytes) -> Writer:
    return _pieces(lambda: (head, *(face * 10_000 for _ in range(MANY // 10_000))))


FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 9 0 0\nvertex 0 9 0\nendloop\nendfacet\n"
TETRA_OBJ = b"v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\n"

MESHES: dict[str, tuple[str, Writer]] = {
    "PLY with two billion vertices": (".ply", _bytes(_ply(2_000_000_000, 1, bytes(64)))),
    "PLY text with two billion faces": (".ply", _bytes(_ply(3, 2_000_000_000, b"0 0 0\n" * 3, "ascii"))),
    "PLY with a negative count": (".ply", _bytes(_ply(-1, -1, bytes(64)))),
    "PLY with an unknown type": (".ply", _bytes(_ply(3, 1, bytes(64)).replace(b"float x", b"quaternion x"))),
    "PLY with a header that never ends": (".ply", _bytes(b"ply\nformat ascii 1.0\n" + b"comment x\n" * 1_000_000)),
    "PLY of ten million triangles": (
        ".ply",
        _many(_ply(4, MANY, CORNERS), struct.pack("<Biii", 3, 0, 2, 1)),
    ),
    "OFF with two billion vertices": (".off", _bytes("OFF\n2000000000 2000000000 0\n0 0 0\n")),
    "OFF with a negative count": (".off", _bytes("OFF\n-4 -4 0\n0 0 0\n")),
    "OFF with numbers that are none": (".off", _bytes("OFF\n4 1 0\nnan 0 0\n1 0 0\n0 inf 0\n0 0 1\n3 0 1 2\n")),
    "OFF of ten million triangles": (
        ".off",
        _many(f"OFF\n4 {MANY} 0\n0 0 0\n9 0 0\n0 9 0\n0 0 9\n".encode(), b"3 0 2 1\n"),
    ),
    "OBJ with vertices that are not there": (".obj", _bytes(TETRA_OBJ + b"f 1 2 4000000000\n")),
    "OBJ with numbers that are none": (".obj", _bytes(b"v nan inf -inf\n" + TETRA_OBJ + b"f 1 2 3\n")),
    "OBJ that reads a file": (".obj", _bytes(b"mtllib ../../../../etc/passwd\nusemtl x\n" + TETRA_OBJ + b"f 1 2 3\n")),
    "OBJ with a polygon of a million corners": (".obj", _bytes(TETRA_OBJ + b"f" + b" 1 2 3" * 333_333 + b"\n")),
    "OBJ with a line of 100 MB": (".obj", _pieces(lambda: (b"v ", *(b"1" * MIB for _ in range(100))))),
    "OBJ of 300,000 groups": (".obj", _pieces(lambda: (TETRA_OBJ, *(b"o %d\nf 1 2 3\n" % i for i in range(300_000))))),
    "OBJ of ten million triangles": (".obj", _many(TETRA_OBJ, b"f 1 3 2\n")),
    "STL with a forged count": (".stl", _bytes(bytes(80) + struct.pack("<I", 0xFFFFFFFF) + bytes(500))),
    "STL with numbers that are none": (".stl", _bytes(_box_stl(float("nan")))),
    "STL with infinite numbers": (".stl", _bytes(_box_stl(float("inf")))),
    "STL with numbers that overflow": (".stl", _bytes(_box_stl(3e38))),
    "STL of ten million triangles": (
        ".stl",
        _many(bytes(80) + struct.pack("<I", MANY), struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 9, 0, 0, 0, 9, 0, 0)),
    ),
    "STL text of two million triangles": (
        ".stl",
        _pieces(lambda: (b"solid x\n", *(FACET * 10_000 for _ in range(201)), b"endsolid x\n")),
    ),
    "STEP of nothing": (".step", _bytes("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n")),
    "STEP that is cut": (".step", _bytes("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=CARTESIAN_POINT('',(0.")),
    "STEP in a circle": (
        ".step",
        _bytes(
            "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=MANIFOLD_SOLID_BREP('',#1);\n#2=ADVANCED_BREP_SHAPE_REPRESENTATION"
            "('',(#1,#2),#2);\nENDSEC;\nEND-ISO-10303-21;\n"
        ),
    ),
    "STEP that is too deep": (
        ".step",
        _bytes("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=A(" + "(" * 1_000_000 + ")" * 1_000_000 + ");\nENDSEC;\n"),
    ),
}  # fmt: skip

# --- what is not what its name says -------------------------------------------------------------------------------

NAMES: dict[str, tuple[str, Writer]] = {
    f"{name} named {suffix}": (suffix, _bytes(content))
    for name, content, suffixes in (
        ("an STL", trimesh.creation.box().export(file_type="stl"), (".glb", ".3mf", ".ply", ".off", ".step")),
        ("a GLB", trimesh.creation.box().export(file_type="glb"), (".stl", ".obj", ".3mf", ".ply", ".off", ".step")),
        ("a program", b"\x7fELF" + bytes(4096), (".stl", ".obj", ".3mf", ".glb", ".step")),
        ("a pickle", b"\x80\x04cposix\nsystem\n(S'true'\ntR.", (".stl", ".obj", ".ply", ".off")),
    )
    for suffix in suffixes
}

FILES: dict[str, tuple[str, Writer]] = {**ARCHIVES, **XML, **GLTF, **MESHES, **NAMES}
