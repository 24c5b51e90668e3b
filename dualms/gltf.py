"""What a GLB says of itself is looked at before a loader follows it: counts, offsets, and the tree of its nodes.

After the glTF 2.0 specification (Khronos), sections 3.5 (nodes are strict trees) and 3.6 (accessors, buffer views).
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from dualms.errors import TooLarge, UnreadableFile

MAX_NODES = 10_000
MAX_JSON_BYTES = 64 * 1024**2
_HEADER = struct.Struct("<4sIIII")  # magic, version, length; then length and type of the first chunk
_JSON = 0x4E4F534A


def refuse_unless_sound(path: Path, max_faces: int) -> None:
    """Refuse a GLB whose description cannot be true, or draws more than ``max_faces`` triangles.

    Raises
    ------
    UnreadableFile
        If the header or the JSON is damaged, a count or offset is not a number from 0 up, or a node has two parents.
    TooLarge
        If it draws too many triangles, or has more than ``MAX_NODES`` nodes.
    """
    document = _document(path)
    try:
        _check_numbers(document)
        faces = _faces(document)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise _damaged(type(error).__name__) from None
    if faces > max_faces:
        raise TooLarge(
            f"The scene draws {faces:,} triangles; the limit is {max_faces:,}.",
            advice="Export it with a coarser tessellation.",
            measured={"faces": faces, "limit": max_faces},
        )


def _document(path: Path) -> dict[str, Any]:
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
        if len(head) < _HEADER.size:
            raise _damaged("header")
        magic, _version, total, length, kind = _HEADER.unpack(head)
        if magic != b"glTF" or kind != _JSON or total != size or length > min(size - _HEADER.size, MAX_JSON_BYTES):
            raise UnreadableFile(
                f"The GLB header does not match the file's size of {size:,} bytes.",
                advice="The file is truncated; send it again.",
                measured={"bytes": size},
            )
        text = file.read(length)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _damaged(type(error).__name__) from None
    if not isinstance(document, dict):
        raise _damaged("no object")
    return document


def _check_numbers(document: dict[str, Any]) -> None:
    stated = [(item, "count") for item in document.get("accessors", [])]
    stated += [(view, key) for view in document.get("bufferViews", []) for key in ("byteOffset", "byteLength")]
    for item, key in stated:
        value = item.get(key, 0)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise _damaged(f"{key} = {value!r:.20}")


def _faces(document: dict[str, Any]) -> int:
    """Triangles that the scenes draw, each instance counted."""
    nodes, meshes, accessors = (document.get(key, []) for key in ("nodes", "meshes", "accessors"))
    if len(nodes) > MAX_NODES:
        raise TooLarge(
            f"The scene has {len(nodes):,} nodes; the limit is {MAX_NODES:,}.",
            advice="Export the envelope alone, as one body.",
            measured={"nodes": len(nodes)},
        )
    waiting = [index for scene in document.get("scenes", []) for index in scene.get("nodes", [])]
    seen: set[int] = set()
    count = 0
    while waiting:
        index = waiting.pop()
        if index in seen:
            raise _damaged(f"node {index} stands in two places")
        seen.add(index)
        node = nodes[index]
        waiting += node.get("children", [])
        if "mesh" in node:
            for primitive in meshes[node["mesh"]]["primitives"]:
                corners = primitive.get("indices", primitive["attributes"]["POSITION"])
                count += accessors[corners]["count"] // 3
    return count


def _damaged(what: str) -> UnreadableFile:
    return UnreadableFile(f"The GLB file contradicts itself ({what}).", advice="Export it again.")
