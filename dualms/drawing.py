"""The pictures that clients download, in a module of their own: what draws costs a second to load."""

from __future__ import annotations

from pathlib import Path

from dualms.body.body import Body
from dualms.cut.partition import Partition
from dualms.domain import Domain
from dualms.graph.graph import Graph
from dualms.maps import Array, maps
from dualms.pictures import preview
from dualms.sections import sections_picture
from dualms.skeleton_mesh import skeleton_meshes
from dualms.triangles import TriangleMesh


def draw(
    folder: Path,
    domain: Domain,
    graph: Graph,
    partition: Partition,
    surface: TriangleMesh,
    curvature: Array,
    body: Body,
    width: int,
) -> None:
    """Draw preview and maps, so many pixels across, and sections.

    Parameters
    ----------
    folder
        Where the files go.
    domain, graph, partition
        In the unit-cube frame.
    surface, body
        In metres.
    curvature
        (V,) mean curvature at the surface's vertices, 1/m.
    width
        Of the preview, in pixels; the two maps share it.
    """
    bones = skeleton_meshes(domain, graph, partition)
    preview(body, bones["skeleton_hot"], bones["skeleton_cold"], folder / "preview.png", width)
    maps(surface, curvature, body, folder / "maps.png", width // 2)
    sections_picture(domain, body, folder / "sections.png")
