"""Meshes as files: binary STL, 3MF with its unit and colours (lib3mf), and a coloured GLB scene (trimesh)."""

from __future__ import annotations

import ctypes
import locale
import uuid
from pathlib import Path

import lib3mf
import numpy as np
import trimesh
from numpy.typing import NDArray

from dualms.spec import Unit
from dualms.triangles import TriangleMesh

Colour = tuple[int, int, int, int]

HOT: Colour = (214, 69, 52, 255)
COLD: Colour = (52, 112, 196, 255)
METAL: Colour = (176, 178, 184, 255)
SIDE_COLOURS: dict[int, Colour] = {0: METAL, 1: HOT, -1: COLD}

_3MF_UNITS = {
    Unit.M: lib3mf.ModelUnit.Meter,
    Unit.CM: lib3mf.ModelUnit.CentiMeter,
    Unit.MM: lib3mf.ModelUnit.MilliMeter,
    Unit.IN: lib3mf.ModelUnit.Inch,
}


def write_stl(mesh: TriangleMesh, path: Path) -> None:
    """Write a binary STL; coordinates are rounded to single precision, the format's own."""
    path.write_bytes(trimesh.exchange.stl.export_stl(_trimesh(mesh)))


def single_precision(mesh: TriangleMesh) -> TriangleMesh:
    """An open mesh with vertices that single precision can hold and tell apart.

    Closed meshes come so from :func:`dualms.body.written.as_written`. Here vertices go to a lattice of two
    steps of single precision (at the farthest coordinate), and those that meet there are moved to free places.
    """
    step = 2.0 * float(np.spacing(np.float32(np.abs(mesh.vertices).max(initial=1e-30))))
    places = np.rint(mesh.vertices / step).astype(np.int64)
    aside = np.random.default_rng(0)  # the same for the same mesh
    while True:
        order = np.lexsort(places.T)
        again = (places[order[1:]] == places[order[:-1]]).all(axis=1)
        taken = np.sort(order[1:][again])
        if len(taken) == 0:
            return TriangleMesh(np.asarray(places * step, dtype=np.float64), mesh.faces)
        places[taken] += aside.integers(-2, 3, (len(taken), 3))


def write_3mf(mesh: TriangleMesh, side: NDArray[np.int64], units: Unit, path: Path) -> None:
    """Write a 3MF whose triangles are coloured by side (1 hot, -1 cold, 0 outside).

    Notes
    -----
    Identifiers are constants and lib3mf writes no time, so the same mesh gives the same bytes.
    """
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(_3MF_UNITS[units])
    item = model.AddMeshObject()
    item.SetName("solid")
    vertices = (lib3mf.Position * len(mesh.vertices)).from_buffer_copy(mesh.vertices.astype(np.float32).tobytes())
    triangles = (lib3mf.Triangle * len(mesh.faces)).from_buffer_copy(mesh.faces.astype(np.uint32).tobytes())
    # The C functions themselves: their Python face copies arrays element by element, seconds for a million triangles.
    counts = ctypes.c_uint64(len(vertices)), ctypes.c_uint64(len(triangles))
    wrapper.checkError(
        item, wrapper.lib.lib3mf_meshobject_setgeometry(item._handle, counts[0], vertices, counts[1], triangles)
    )
    group = model.AddColorGroup()
    identifier = {s: group.AddColor(lib3mf.Color(*colour)) for s, colour in SIDE_COLOURS.items()}
    resource = group.GetResourceID()
    properties = np.empty((len(side), 4), dtype=np.uint32)
    properties[:, 0] = resource
    for s, k in identifier.items():
        properties[side == s, 1:] = k
    given = (lib3mf.TriangleProperties * len(side)).from_buffer_copy(properties.tobytes())
    wrapper.checkError(item, wrapper.lib.lib3mf_meshobject_setalltriangleproperties(item._handle, counts[1], given))
    item.SetObjectLevelProperty(resource, identifier[0])
    built = model.AddBuildItem(item, wrapper.GetIdentityTransform())
    for name, named in (("object", item.SetUUID), ("item", built.SetUUID), ("build", model.SetBuildUUID)):
        named(str(uuid.uuid5(uuid.NAMESPACE_OID, name)))
    writer = model.QueryWriter("3mf")
    writer.SetDecimalPrecision(9)
    before = locale.setlocale(locale.LC_ALL)
    try:
        writer.WriteToFile(str(path))
    finally:
        locale.setlocale(locale.LC_ALL, before)  # lib3mf leaves the whole process in the locale C


def write_glb(parts: dict[str, tuple[TriangleMesh, Colour | NDArray[np.uint8]]], path: Path) -> None:
    """Write named meshes as a GLB scene, each with one colour or one a face (F, 4)."""
    scene = trimesh.Scene()
    for name, (mesh, colour) in parts.items():
        shape = _trimesh(mesh)
        shape.visual = trimesh.visual.ColorVisuals(shape, face_colors=colour)
        scene.add_geometry(shape, node_name=name, geom_name=name)
    path.write_bytes(scene.export(file_type="glb"))


def _trimesh(mesh: TriangleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, validate=False)
