"""OpenFOAM's file format, as far as a case written and read here needs it: binary lists under a text header.

Format as in the OpenFOAM user guide, "Basic input/output file format"; labels are 32-bit, scalars 64-bit,
little-endian, as Debian builds it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HEADER = (
    "FoamFile\n{{\n    version 2.0;\n    format {format};\n"
    '    arch "LSB;label=32;scalar=64";\n    class {kind};\n    object {name};\n}}\n'
)
DIMENSIONS = {"U": "[0 1 -1 0 0 0 0]", "p": "[0 2 -2 0 0 0 0]"}
KINDS = {(): "scalar", (3,): "vector"}


def write_text(path: Path, body: str, kind: str = "dictionary") -> None:
    """Write a dictionary in text form."""
    path.write_text(HEADER.format(format="ascii", kind=kind, name=path.name) + body)


def write_list(path: Path, kind: str, values: NDArray[np.generic]) -> None:
    """Write a labelList, or a vectorField of points, as the whole of a file."""
    path.write_bytes(HEADER.format(format="binary", kind=kind, name=path.name).encode() + _packed(values) + b"\n")


def write_faces(path: Path, faces: NDArray[np.int64]) -> None:
    """Write (F, K) faces of K corners each as a faceCompactList."""
    offsets = np.arange(0, faces.size + 1, faces.shape[1])
    header = HEADER.format(format="binary", kind="faceCompactList", name=path.name).encode()
    path.write_bytes(header + _packed(offsets) + b"\n" + _packed(faces.ravel()) + b"\n")


def write_field(path: Path, internal: NDArray[np.float64] | None, boundary: dict[str, dict[str, object]]) -> None:
    """Write a volume field, ``p`` or ``U``.

    Parameters
    ----------
    path
        Its last part names the field.
    internal
        (N,) or (N, 3) values of the cells, or None for zero.
    boundary
        For each patch the entries of its condition; arrays are written as lists.
    """
    kind = "vector" if path.name == "U" else "scalar"
    zero = "(0 0 0)" if kind == "vector" else "0"
    out = [HEADER.format(format="binary", kind=f"vol{kind.capitalize()}Field", name=path.name).encode()]
    out.append(f"dimensions {DIMENSIONS[path.name]};\ninternalField ".encode())
    out.append(f"uniform {zero}".encode() if internal is None else _nonuniform(internal))
    out.append(b";\nboundaryField\n{\n")
    for name, entries in boundary.items():
        out.append(f"    {name}\n    {{\n".encode())
        for key, value in entries.items():
            out.append(f"        {key} ".encode())
            out.append(_nonuniform(value) if isinstance(value, np.ndarray) else str(value).encode())
            out.append(b";\n")
        out.append(b"    }\n")
    out.append(b"}\n")
    path.write_bytes(b"".join(out))


def read_field(
    path: Path, count: int, patches: dict[str, int]
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Read a binary field: internal values, and the ``value`` of each patch that has one.

    Parameters
    ----------
    path
        The field's file.
    count
        Internal values (cells, or internal faces).
    patches
        Faces of each patch.

    Raises
    ------
    ValueError
        If the file does not hold such a field.
    """
    data = path.read_bytes()
    match = re.search(rb"class\s+\w+?(Scalar|Vector)Field", data[:1000])
    if match is None:
        raise ValueError(f"{path.name} is no field")
    width = 3 if match.group(1) == b"Vector" else 1
    start = data.index(b"internalField")
    internal, end = _values(data, start + len(b"internalField"), count, width)
    found = {}
    at = data.index(b"boundaryField", end)
    for name, faces in patches.items():
        at = data.index(f"\n    {name}\n".encode(), at)
        entry = re.compile(rb"\n\s+value\s+|\n    \}").search(data, at)
        if entry is None:
            raise ValueError(f"{path.name} ends within patch {name}")
        at = entry.start()
        if b"value" in entry.group():
            found[name], at = _values(data, entry.end(), faces, width)
    return internal, found


def _values(data: bytes, at: int, count: int, width: int) -> tuple[NDArray[np.float64], int]:
    """``uniform`` or ``nonuniform`` values that start at a position, and where they end."""
    head = re.compile(rb"\s*(uniform|nonuniform)\s*").match(data, at)
    if head is None:
        raise ValueError("a field's values must be uniform or nonuniform")
    if head.group(1) == b"uniform":
        end = data.index(b";", head.end())
        one = np.array(data[head.end() : end].strip(b" ()").split(), dtype=float)
        values = np.tile(one, (count, 1))
    else:
        if count == 0 and re.compile(rb"(List<\w+>\s*)?0\b").match(data, head.end()):
            return np.zeros((0, 3) if width == 3 else 0), head.end()
        size = re.compile(rb"List<\w+>\s*(\d+)\s*\(").match(data, head.end())
        if size is None or int(size.group(1)) != count:
            raise ValueError(f"expected {count} values")
        end = size.end() + 8 * count * width
        values = np.frombuffer(data[size.end() : end], dtype="<f8").reshape(count, width).copy()
    return (values if width == 3 else values[:, 0]), end


def _packed(values: NDArray[np.generic]) -> bytes:
    """Length and raw bytes of a list."""
    kind = "<f8" if values.dtype.kind == "f" else "<i4"
    return f"{len(values)}\n(".encode() + np.ascontiguousarray(values, dtype=kind).tobytes() + b")"


def _nonuniform(values: NDArray[np.float64]) -> bytes:
    return f"nonuniform List<{KINDS[values.shape[1:]]}>\n".encode() + _packed(values.astype(float))
