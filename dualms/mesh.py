"""The uploaded envelope: triangles in metres that form one closed, outward oriented body.

Reading is trimesh's; what a format may not do to us (archives that unpack to gigabytes, forged counts) is looked at
before its loader runs. Callers that read other people's files run this in a process with limits.
"""

from __future__ import annotations

import struct
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dualms.errors import InvalidMesh, MissingUnits, TooLarge, UnreadableFile, UnsupportedFormat
from dualms.spec import Unit

Array = NDArray[np.float64]

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf")
MAX_FACES = 2_000_000
MAX_UNZIPPED_BYTES = 512 * 1024**2
PLANAR_RADIANS = 0.01  # neighbours of a facet differ by less; a curved part that slips in fails the plane fit
SHARP_RADIANS = 0.35  # 20°: more than between the strips of a cylinder of 18 sides
MAX_FACETS = 64
CARRIED_UNITS = {"m": Unit.M, "meter": Unit.M, "meters": Unit.M, "millimeter": Unit.MM, "millimeters": Unit.MM,
                 "mm": Unit.MM, "centimeter": Unit.CM, "centimeters": Unit.CM, "cm": Unit.CM, "inch": Unit.IN,
                 "inches": Unit.IN, "in": Unit.IN}  # fmt: skip


@dataclass(frozen=True)
class Facet:
    """A planar part of the boundary: connected coplanar triangles."""

    triangles: NDArray[np.int64]
    center_m: Array
    normal: Array
    area_m2: float


@dataclass(frozen=True)
class DomainMesh:
    """A closed, outward oriented, single body.

    Parameters
    ----------
    vertices_m
        (V, 3) float64, metres.
    faces
        (F, 3) int64, counter-clockwise seen from outside.
    units
        Unit of the file, in which results are given back.
    """

    vertices_m: Array
    faces: NDArray[np.int64]
    units: Unit

    @cached_property
    def areas(self) -> Array:
        """(F,) triangle areas, m²."""
        return np.asarray(np.linalg.norm(self._crosses, axis=1) / 2)

    @cached_property
    def normals(self) -> Array:
        """(F, 3) outward unit normals."""
        return np.asarray(self._crosses / np.maximum(np.linalg.norm(self._crosses, axis=1), 1e-300)[:, None])

    @cached_property
    def volume_m3(self) -> float:
        """Enclosed volume."""
        return _volume(self.vertices_m, self.faces)

    @cached_property
    def facets(self) -> tuple[Facet, ...]:
        """Planar facets bounded mostly by sharp edges, of more than 0.1 % of the area, largest first (at most 64).

        Strips of a tessellated cylinder are planar too; their smooth borders tell them apart.
        """
        pairs, edges = trimesh.graph.face_adjacency(self.faces, return_edges=True)
        cosine = np.einsum("ij,ij->i", self.normals[pairs[:, 0]], self.normals[pairs[:, 1]])
        flat = cosine > np.cos(PLANAR_RADIANS)
        links = coo_array((np.ones(flat.sum()), tuple(pairs[flat].T)), shape=(len(self.faces),) * 2)
        count, label = connected_components(links, directed=False)
        length = np.linalg.norm(np.diff(self.vertices_m[edges], axis=1)[:, 0], axis=1)
        border = label[pairs[:, 0]] != label[pairs[:, 1]]
        sharp = border & (cosine < np.cos(SHARP_RADIANS))
        round_, sharply = (
            sum(np.bincount(label[pairs[kind, k]], weights=length[kind], minlength=count) for k in (0, 1))
            for kind in (border, sharp)
        )
        area = np.bincount(label, weights=self.areas)
        candidates = np.flatnonzero((area > 1e-3 * self.areas.sum()) & (sharply > 0.5 * round_))
        facets = [f for k in candidates if (f := self._planar(np.flatnonzero(label == k)))]
        facets.sort(key=lambda f: (-round(f.area_m2 / self.areas.sum(), 5), *f.center_m.round(7).tolist()))
        return tuple(facets[:MAX_FACETS])

    @cached_property
    def _crosses(self) -> Array:
        a, b, c = (self.vertices_m[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def _planar(self, triangles: NDArray[np.int64]) -> Facet | None:
        weight = self.areas[triangles]
        normal = np.average(self.normals[triangles], axis=0, weights=weight)
        normal /= np.linalg.norm(normal)
        points = self.vertices_m[self.faces[triangles]]
        center = np.average(points.mean(axis=1), axis=0, weights=weight)
        if np.abs((points - center) @ normal).max() > 1e-3 * np.sqrt(weight.sum()):
            return None
        return Facet(triangles, center, normal, float(weight.sum()))


class FacetRecord(BaseModel):
    """A planar facet as clients see it, in the domain's units."""

    model_config = ConfigDict(frozen=True)
    index: int
    center: tuple[float, float, float]
    normal: tuple[float, float, float]
    area: float


class Inspection(BaseModel):
    """What a domain file holds, in the domain's units."""

    model_config = ConfigDict(frozen=True)
    units: Unit
    vertices: int
    faces: int
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    volume: float
    area: float
    watertight: bool
    facets: tuple[FacetRecord, ...]
    problems: tuple[str, ...]


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
        STL (text or binary), OBJ, PLY, OFF, GLB or 3MF file.
    units
        Length unit of the numbers; None where the file carries it (3MF, GLB). Given, it overrides the file's.
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
    vertices, faces = _cleaned(soup, problems)
    _refuse_unsound(vertices, faces)
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
    if suffix == ".glb" and (size < 20 or struct.unpack("<I", head[8:12])[0] != size):
        raise UnreadableFile(
            f"The GLB header does not match the file's size of {size:,} bytes.",
            advice="The file is truncated; send it again.",
            measured={"bytes": size},
        )
    if suffix == ".3mf":
        try:
            with zipfile.ZipFile(path) as archive:
                unzipped = sum(item.file_size for item in archive.infolist())
        except zipfile.BadZipFile:
            raise UnreadableFile("The 3MF archive is damaged.", advice="Export it again.") from None
        if unzipped > MAX_UNZIPPED_BYTES:
            raise TooLarge(
                f"The 3MF archive unpacks to {unzipped / 1e6:,.0f} MB; the limit is {MAX_UNZIPPED_BYTES / 1e6:.0f} MB.",
                advice="Export it with a coarser tessellation.",
                measured={"unzipped_bytes": unzipped},
            )


def _is_text(head: bytes) -> bool:
    return b"\0" not in head


def _load(path: Path, suffix: str) -> trimesh.Trimesh:
    try:
        with path.open("rb") as file:
            loaded = trimesh.load_scene(file, file_type=suffix[1:], process=False)
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
    mesh.units = loaded.units
    return mesh


def _cleaned(soup: trimesh.Trimesh, problems: list[str]) -> tuple[Array, NDArray[np.int64]]:
    """Vertices merged where they coincide exactly (to 1e-9 of the size), degenerate and repeated triangles dropped."""
    if not np.isfinite(soup.vertices).all():
        bad = int((~np.isfinite(soup.vertices).all(axis=1)).sum())
        raise InvalidMesh(
            f"{bad} vertices have coordinates that are not finite numbers.",
            advice="Export the domain again.",
            measured={"vertices": bad},
        )
    vertices = np.asarray(soup.vertices, dtype=np.float64)
    size = float(np.ptp(vertices, axis=0).max())
    if not 0 < size < 1e9:
        raise InvalidMesh("All vertices coincide, or lie beyond 1e9 units.", advice="Check the export's scale.")
    _, first, inverse = np.unique(np.rint(vertices / (1e-8 * size)), axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[np.asarray(soup.faces)]
    degenerate = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if degenerate.any():
        problems.append(f"{int(degenerate.sum())} degenerate triangles were dropped.")
    faces = faces[~degenerate]
    if len(faces) == 0:
        raise InvalidMesh("Every triangle is degenerate.", advice="Check the export's scale and precision.")
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[first][used], faces.reshape(-1, 3).astype(np.int64)


def _refuse_unsound(vertices: Array, faces: NDArray[np.int64]) -> None:
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, inverse, counts = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    for bad, what, advice in (
        (counts == 1, "open: {n} edges belong to one triangle only", "Close the holes in CAD and export a solid."),
        (counts > 2, "not manifold: {n} edges belong to more than two triangles", "Unite touching bodies in CAD."),
    ):
        if bad.any():
            raise InvalidMesh(
                f"The mesh is {what.format(n=int(bad.sum()))}, first near {_where(vertices, directed, bad[inverse])}.",
                advice=advice,
                measured={"edges": int(bad.sum())},
            )
    _, repeated = np.unique(directed, axis=0, return_counts=True)
    forward = directed[:, 0] < directed[:, 1]
    balance = np.bincount(inverse, weights=np.where(forward, 1, -1))
    if (repeated > 1).any():
        raise InvalidMesh(
            f"Neighbouring triangles are oriented against each other along {int((balance != 0).sum())} edges, "
            f"first near {_where(vertices, directed, (balance != 0)[inverse])}.",
            advice="Recompute the normals to point outward and export again.",
            measured={"edges": int((balance != 0).sum())},
        )
    n = len(faces)
    order = np.argsort(inverse, kind="stable").reshape(-1, 2) % n
    links = coo_array((np.ones(len(order)), (order[:, 0], order[:, 1])), shape=(n, n))
    bodies, _ = connected_components(links, directed=False)
    if bodies > 1:
        raise InvalidMesh(
            f"The file holds {bodies} separate closed surfaces.",
            advice="Send one body without inner voids; unite or split the bodies in CAD.",
            measured={"bodies": int(bodies)},
        )
    volume, size = _volume(vertices, faces), np.ptp(vertices, axis=0)
    if abs(volume) < 1e-6 * size.max() ** 3:
        raise InvalidMesh(
            f"The body encloses next to no volume: {volume:.3g} units³ in a box of {np.round(size, 6).tolist()} units.",
            advice="Send a solid body, not a sheet.",
            measured={"volume": volume},
        )
    if volume < 0:
        raise InvalidMesh(
            f"The faces point inward: the enclosed volume is {volume:.4g} units³.",
            advice="Flip the normals and export again.",
            measured={"volume": volume},
        )


def _where(vertices: Array, edges: NDArray[np.int64], bad: NDArray[np.bool_]) -> list[float]:
    """Middle of the first bad edge, rounded for people."""
    return [float(x) for x in vertices[edges[int(bad.argmax())]].mean(axis=0).round(4)]


def _volume(vertices: Array, faces: NDArray[np.int64]) -> float:
    a, b, c = (vertices[faces[:, k]] - vertices[faces[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
