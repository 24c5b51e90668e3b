"""Meshes in the formats that a specification asks for: OBJ (trimesh), and VTU (meshio) with figures on the meshes.

Coordinates are in the domain's own unit, as in every mesh file; figures are in SI, with the unit in their names.
"""

from __future__ import annotations

from pathlib import Path

import igl
import meshio
import numpy as np
import trimesh
from numpy.typing import NDArray

from dualms.body.body import Body, Fluid
from dualms.body.files import single_precision
from dualms.body.patches import INTERFACE
from dualms.measure.curvature import mean_curvature
from dualms.spec import MeshFormat, Unit
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

OBJ_DIGITS = 10  # after the point: single precision comes back as it was, in metres too


def write_formats(
    formats: tuple[MeshFormat, ...], folder: Path, surface: TriangleMesh, body: Body, units: Unit
) -> None:
    """Write a body's meshes in each of the formats.

    Parameters
    ----------
    formats
        ``"obj"``: ``solid.obj``, ``fluid_hot.obj``, ``fluid_cold.obj``, ``surface.obj``. ``"vtu"``: ``wall.vtu``, the
        separating surface with point data ``mean_curvature_per_m`` and ``thickness_m`` (see :func:`wall_thickness_m`),
        ``solid.vtu`` with cell data ``side`` (1 hot, -1 cold, 0 outside), and ``fluid_hot.vtu``, ``fluid_cold.vtu``
        with cell data ``patch``, the place of the patch's name in ``patches.json``.
    folder
        Where they go.
    surface, body
        In metres.
    units
        Unit of the files.
    """
    fluids = {"fluid_hot": body.hot, "fluid_cold": body.cold}
    sheet, solid = _in(units, surface), _in(units, body.solid)
    sides = {name: _in(units, fluid.mesh) for name, fluid in fluids.items()}
    if "obj" in formats:
        for name, mesh in {"surface": single_precision(sheet), "solid": solid, **sides}.items():
            write_obj(mesh, units, folder / f"{name}.obj")
    if "vtu" in formats:
        figures = {
            "mean_curvature_per_m": mean_curvature(surface.vertices, surface.faces),
            "thickness_m": wall_thickness_m(surface, body),
        }
        write_vtu(sheet, figures, {}, folder / "wall.vtu")
        write_vtu(solid, {}, {"side": body.solid_side}, folder / "solid.vtu")
        for name, mesh in sides.items():
            write_vtu(mesh, {}, {"patch": fluids[name].patch}, folder / f"{name}.vtu")


def write_obj(mesh: TriangleMesh, units: Unit, path: Path) -> None:
    """Write an OBJ; its unit stands in a comment, as the format has no other place for it."""
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, validate=False)
    text = trimesh.exchange.obj.export_obj(
        shape,
        include_normals=False,
        include_color=False,
        include_texture=False,
        digits=OBJ_DIGITS,
        header=f"DualMS, lengths in {units.value}",
    )
    path.write_text(text, encoding="ascii")


def write_vtu(mesh: TriangleMesh, points: dict[str, Array], cells: dict[str, NDArray[np.int64]], path: Path) -> None:
    """Write a VTU with figures at the vertices (V,) and the triangles (F,)."""
    grid = meshio.Mesh(
        mesh.vertices,
        [("triangle", mesh.faces)],
        point_data=points,
        cell_data={name: [values] for name, values in cells.items()},
    )
    grid.write(path, file_format="vtu")


def wall_thickness_m(sheet: TriangleMesh, body: Body) -> Array:
    """Thickness of the wall at the vertices of its middle surface: the way to the hot side and to the cold side.

    Parameters
    ----------
    sheet
        The separating surface, metres.
    body
        Its fluids bound the wall.

    Returns
    -------
    (V,) float64
        Metres; NaN where the nearest triangle of a side lies on that side's rim: there, beside the shell and inside
        it, the wall has no thickness of its own.
    """
    total = np.zeros(len(sheet.vertices))
    for fluid in (body.hot, body.cold):
        side, rim = _interface(fluid)
        squared, nearest, _ = igl.point_mesh_squared_distance(sheet.vertices, side.vertices, side.faces)
        total += np.where(rim[nearest], np.nan, np.sqrt(squared))
    return total


def _interface(fluid: Fluid) -> tuple[TriangleMesh, NDArray[np.bool_]]:
    """The fluid's side of the wall, and which of its triangles (F,) touch its border."""
    side = fluid.mesh.part(fluid.patch == INTERFACE)
    border = np.zeros(len(side.vertices), dtype=bool)
    border[side.border] = True
    return side, np.asarray(border[side.faces].any(axis=1))


def _in(units: Unit, mesh: TriangleMesh) -> TriangleMesh:
    return mesh.moved(1 / units.metres, np.zeros(3))
