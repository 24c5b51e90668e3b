"""Reading of envelopes from files, and what clients are told about them.

Reading is trimesh's, and OpenCASCADE's (by cascadio) for STEP; what a format may not do to us (archives that unpack to
gigabytes, forged counts) is looked at before its loader runs. Callers that read other people's files run this in a
process with limits.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path

import cascadio
import trimesh

from dualms import gltf
from dualms.archives import refuse_unless_small
from dualms.errors import MissingUnits, TooLarge, UnreadableFile, UnsupportedFormat
from dualms.inspection import FacetRecord, Inspection
from dualms.mesh import DomainMesh
from dualms.soundness import cleaned, refuse_unsound
from dualms.spec import Unit

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf", ".step", ".stp")
CAD = (".step", ".stp")
CAD_DEVIATION_MM = 0.01
CAD_RADIANS = 0.1  # between neighbouring triangles of a curved CAD face: 63 segments a circle
MAX_FACES = 2_000_000
MAX_UNZIPPED_BYTES = 512 * 1024**2
CARRIED_UNITS = {"m": Unit.M, "meter": Unit.M, "meters": Unit.M, "millimeter": Unit.MM, "millimeters": Unit.MM,
                 "mm": Unit.MM, "centimeter": Unit.CM, "centimeters": Unit.CM, "cm": Unit.CM, "inch": Unit.IN,
                 "inches": Unit.IN, "in": Unit.IN}  # fmt: skip


def inspect_file(path: Path, units: Unit | None, max_faces: int = MAX_FACES, suffix: str | None = None) -> Inspection:
    """Read a domain file and say what is in it.

    Raises
    ------
    DualMSError
        As :func:`read_domain_mesh`.
    """
    mesh, problems = _read(path, units, max_faces, suffix)
    k = 1 / mesh.units.metres
    low, high = (mesh.vertices_m.min(axis=0) * k).tolist(), (mesh.vertices_m.max(axis=0) * k).tolist()
    facets = tuple(
        FacetRecord(
            index=i,
            center=tuple((f.center_m * k).round(9).tolist()),
            normal=tuple((f.normal + 0.0).round(9).tolist()),
            area=f.area_m2 * k**2,
        )
        for i, f in enumerate(mesh.facets)
    )
    return Inspection(
        units=mesh.units,
        vertices=len(mesh.vertices_m),
        faces=len(mesh.faces),
        bounds=(tuple(low), tuple(high)),
        volume=mesh.volume_m3 * k**3,
        area=float(mesh.areas.sum()) * k**2,
        watertight=True,
        facets=facets,
        problems=tuple(problems),
    )


def read_domain_mesh(
    path: Path, units: Unit | None, max_faces: int = MAX_FACES, suffix: str | None = None
) -> DomainMesh:
    """Read and check an envelope.

    Parameters
    ----------
    path
        STL (text or binary), OBJ, PLY, OFF, GLB, 3MF or STEP file.
    units
        Length unit of the numbers; None where the file carries it (3MF, GLB). Given, it overrides the file's. A STEP
        file is always read in its own unit; this is then the unit of the specification and of the results.
    max_faces
        Refuse files with more triangles.
    suffix
        Format, such as ``".stl"``, where the path's own suffix does not tell.

    Raises
    ------
    UnsupportedFormat, UnreadableFile, TooLarge, MissingUnits, InvalidMesh
        Each says what is wrong, where, and what to try.
    """
    return _read(path, units, max_faces, suffix)[0]


def _read(path: Path, units: Unit | None, max_faces: int, suffix: str | None) -> tuple[DomainMesh, list[str]]:
    suffix = (suffix or path.suffix).lower()
    if suffix not in SUFFIXES:
        raise UnsupportedFormat(
            f"Files of type '{suffix or path.name}' are not read.", advice=f"Export one of: {', '.join(SUFFIXES)}."
        )
    _look_before_loading(path, suffix, max_faces)
    soup = _load(path, suffix)
    problems: list[str] = []
    if suffix in CAD:  # read in metres whatever its own unit; numbers are given back in the unit that was asked for
        soup.apply_scale(1 / (units or Unit.MM).metres)
        units = units or Unit.MM
    carried = CARRIED_UNITS.get(str(soup.units or "").lower()) if suffix in (".3mf", ".glb") else None
    if suffix == ".glb" and carried is None:
        carried = Unit.M  # the format's definition
    chosen = units or carried
    if chosen is None:
        raise MissingUnits(
            f"A {suffix[1:].upper()} file carries no length unit and the request names none.",
            advice="Say which: units = m, cm, mm or in.",
        )
    if units and carried and units != carried:
        problems.append(f"The file says {carried.value}; the request's {units.value} was used.")
    if len(soup.faces) > max_faces:
        raise TooLarge(
            f"The mesh has {len(soup.faces):,} triangles; the limit is {max_faces:,}.",
            advice="Export it with a coarser tessellation.",
            measured={"faces": len(soup.faces), "limit": max_faces},
        )
    vertices, faces = cleaned(soup, problems)
    refuse_unsound(vertices, faces)
    return DomainMesh(vertices * chosen.metres, faces, chosen), problems


def _look_before_loading(path: Path, suffix: str, max_faces: int) -> None:
    """What can be told from size, magic and directory, before a loader allocates anything."""
    size = path.stat().st_size
    if size == 0:
        raise UnreadableFile("The file is empty.", advice="Export the domain again and check the upload.")
    with path.open("rb") as file:
        head = file.read(512)
    claimed = (
        "3mf" if head[:4] == b"PK\x03\x04" else "glb" if head[:4] == b"glTF" else "ply" if head[:3] == b"ply" else None
    )
    if claimed is None and head.lstrip()[:3] == b"OFF":
        claimed = "off"
    text = head.lstrip()[:6].lower()
    if suffix in CAD and not head.lstrip().startswith(b"ISO-10303-21"):
        raise UnreadableFile("The file does not begin like a STEP file.", advice="Export it as STEP AP214 or AP242.")
    if suffix in (".3mf", ".glb", ".ply", ".off") and claimed != suffix[1:]:
        raise UnreadableFile(
            f"The file does not begin like a {suffix[1:].upper()} file.",
            advice="Check that the extension fits the format, and that the upload is complete.",
        )
    if suffix in (".stl", ".obj") and claimed is not None:
        raise UnreadableFile(
            f"The file is named {suffix} but begins like a {claimed.upper()} file.",
            advice=f"Rename it to .{claimed}, or export it as {suffix[1:].upper()}.",
        )
    if suffix == ".stl" and not (text.startswith(b"solid") and _is_text(head)):
        count = struct.unpack("<I", head[80:84])[0] if size >= 84 else -1
        if count <= 0 or size != 84 + 50 * count:
            raise UnreadableFile(
                f"A binary STL of {size:,} bytes holds {max(size - 84, 0) // 50:,} triangles, but the file claims "
                f"{max(count, 0):,}.",
                advice="The file is truncated or not an STL; export it again.",
                measured={"bytes": size, "claimed_faces": count},
            )
        if count > max_faces:
            raise TooLarge(
                f"The mesh has {count:,} triangles; the limit is {max_faces:,}.",
                advice="Export it with a coarser tessellation.",
                measured={"faces": count, "limit": max_faces},
            )
    if suffix == ".glb":
        gltf.refuse_unless_sound(path, max_faces)
    if suffix == ".3mf":
        refuse_unless_small(path, MAX_UNZIPPED_BYTES)


def _is_text(head: bytes) -> bool:
    return b"\0" not in head


def _load(path: Path, suffix: str) -> trimesh.Trimesh:
    try:
        content = path.read_bytes()
        if suffix in CAD:
            content = cascadio.to_glb_bytes(content, cascadio.STEP, CAD_DEVIATION_MM, CAD_RADIANS)
        kind = "glb" if suffix in CAD else suffix[1:]
        loaded = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
        mesh = loaded.to_mesh()
    except MemoryError:
        raise
    except Exception as error:  # loaders raise anything; the cause is named, not hidden
        raise UnreadableFile(
            f"The {suffix[1:].upper()} file could not be read ({type(error).__name__}).",
            advice="Export it again, as binary STL if in doubt.",
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise UnreadableFile(
            "The file holds no triangles.", advice="Export a triangulated solid, not curves or points."
        )
    if mesh.faces.min() < 0:
        raise UnreadableFile("A triangle names a vertex with a negative number.", advice="Export it again.")
    mesh.units = loaded.units
    return mesh
