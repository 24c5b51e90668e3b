"""The graph and the two skeletons as meshes of thin bars, for scenes and pictures."""

from __future__ import annotations

import numpy as np

from dualms.cut.partition import Partition
from dualms.domain import Domain
from dualms.graph.graph import Graph
from dualms.grid import Array
from dualms.surface import to_metres
from dualms.triangles import TriangleMesh

THICK, THIN = 0.004, 0.001  # radius over the longest side: of skeletons, and of edges that the cut severs
SIDES = 5


def skeleton_meshes(domain: Domain, graph: Graph, partition: Partition) -> dict[str, TriangleMesh]:
    """Bars along the edges, each led through the face that its two cells share.

    Parameters
    ----------
    domain
        Whose frame the graph is in.
    graph, partition
        Sites, edges, and the side of each site.

    Returns
    -------
    dict
        ``skeleton_hot`` and ``skeleton_cold``, the edges within either side, and ``cut_edges``, those between the
        sides; in metres.
    """
    ends = partition.labels[graph.edges]
    chosen = {
        "skeleton_hot": ((ends == 1).all(axis=1), THICK),
        "skeleton_cold": ((ends == -1).all(axis=1), THICK),
        "cut_edges": (ends[:, 0] != ends[:, 1], THIN),
    }
    made = {}
    for name, (edges, radius) in chosen.items():
        a, b = graph.sites[graph.edges[edges]].transpose(1, 0, 2)
        passages = graph.passages[edges]
        made[name] = to_metres(domain, bars(np.concatenate([a, passages]), np.concatenate([passages, b]), radius))
    return made


def bars(starts: Array, ends: Array, radius: float) -> TriangleMesh:
    """Closed prisms round segments.

    Parameters
    ----------
    starts, ends
        (N, 3) of the segments; those shorter than a hundredth of the radius are left out.
    radius
        Of the prisms, in the same unit.
    """
    along = ends - starts
    length = np.linalg.norm(along, axis=1)
    kept = length > 0.01 * radius
    starts, ends, along = starts[kept], ends[kept], along[kept] / length[kept, None]
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1)[:, None]
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = radius * (
        np.cos(turn)[None, :, None] * across[:, None] + np.sin(turn)[None, :, None] * np.cross(along, across)[:, None]
    )
    vertices = np.concatenate([starts[:, None] + ring, ends[:, None] + ring], axis=1).reshape(-1, 3)
    k = np.arange(SIDES)
    after = (k + 1) % SIDES
    sides = np.concatenate([np.stack([k, after, after + SIDES], 1), np.stack([k, after + SIDES, k + SIDES], 1)])
    fan = np.arange(1, SIDES - 1)
    caps = np.concatenate([np.stack([0 * fan, fan + 1, fan], 1), SIDES + np.stack([0 * fan, fan, fan + 1], 1)])
    faces = np.concatenate([sides, caps])
    first = 2 * SIDES * np.arange(len(starts))
    return TriangleMesh(vertices, (first[:, None, None] + faces).reshape(-1, 3).astype(np.int64))
