"""Edges restricted to the domain: nothing through a wall, agreement with Delaunay where the domain is convex."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import Delaunay, cKDTree

from dualms.domain import Domain
from dualms.graph.edges import cell_adjacency, connected_cells, sites_in_cells
from dualms.graph.graph import site_graph
from dualms.grid import Grid
from dualms.spec import GraphSpec


def test_adjacency_of_a_lattice_is_its_six_neighbours() -> None:
    grid = Grid(np.full(3, 1 / 24), 1 / 12, (12, 12, 12))
    sites = Grid(np.full(3, 1 / 8), 1 / 4, (4, 4, 4)).points()
    inside = np.ones(grid.shape, dtype=bool)
    cells = connected_cells(inside, cKDTree(sites).query(grid.points())[1].astype(np.int32), 64)
    edges, faces, middles = cell_adjacency(cells)
    assert (faces == 9).all()
    assert len(edges) == 3 * 4 * 4 * 3
    lengths = np.linalg.norm(sites[edges[:, 0]] - sites[edges[:, 1]], axis=1)
    np.testing.assert_allclose(lengths, 0.25)
    np.testing.assert_allclose(grid.origin + grid.spacing * middles, sites[edges].mean(axis=1), atol=1e-12)


def test_edges_in_a_cube_are_delaunay_edges() -> None:
    generator = np.random.default_rng(2)
    grid = Grid(np.full(3, 1 / 96), 1 / 48, (48, 48, 48))
    sites = generator.random((60, 3))
    inside = np.ones(grid.shape, dtype=bool)
    cells = connected_cells(inside, cKDTree(sites).query(grid.points())[1].astype(np.int32), 60)
    edges = {tuple(e) for e in cell_adjacency(cells)[0]}
    delaunay = set()
    for tetrahedron in Delaunay(sites).simplices:
        for i in range(4):
            for j in range(i):
                delaunay.add(tuple(sorted((tetrahedron[i], tetrahedron[j]))))
    # Voxels see only what is in the cube, and miss faces below their size: never an edge that Delaunay lacks.
    missing = len(edges - delaunay)
    assert missing <= 0.01 * len(edges)


def _slotted_box() -> Domain:
    """A box of 1 × 1 × 0.25, cut in the plane y = 0.5 by a slot 0.03 wide that leaves only x > 0.75 open."""
    box = trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 0.25]])
    slot = trimesh.creation.box(bounds=[[-0.1, 0.485, -0.1], [0.75, 0.515, 0.35]])
    body = trimesh.boolean.difference([box, slot], engine="manifold")
    return Domain(np.array(body.vertices), np.array(body.faces, dtype=np.int64), 1.0, np.zeros(3), ())


def test_no_edge_crosses_a_slot_thinner_than_a_cell() -> None:
    domain = _slotted_box()
    graph = site_graph(domain, None, GraphSpec(sites=60), 0)
    ends = graph.sites[graph.edges]
    crossings = []
    for start, stop in ((ends[:, 0], graph.passages), (graph.passages, ends[:, 1])):
        across = (start[:, 1] - 0.5) * (stop[:, 1] - 0.5) < 0
        share = (0.5 - start[across, 1]) / (stop[across, 1] - start[across, 1])
        crossings.append(start[across, 0] + share * (stop[across, 0] - start[across, 0]))
    crossing = np.concatenate(crossings)
    assert len(crossing) > 0
    assert crossing.min() > 0.74
    assert (domain.signed_distance(graph.sites) > 0).all()


def test_cells_split_by_a_gap_keep_one_part() -> None:
    inside = np.ones((9, 5, 5), dtype=bool)
    inside[4] = False
    cells = np.zeros(int(inside.sum()), dtype=np.int32)
    cells[-20:] = 1  # the second cell owns only a part of the far side; the rest there is cut off from the first cell
    volume = connected_cells(inside, cells, 2)
    assert set(np.unique(volume[5:])) == {1}
    assert set(np.unique(volume[:4])) == {0}


def test_a_site_outside_its_cell_moves_into_it() -> None:
    grid = Grid(np.zeros(3), 1.0, (5, 5, 1))
    volume = np.ones((5, 5, 1), dtype=np.int32)
    volume[0, :] = volume[:, 0] = 0  # an L-shaped cell, its centroid outside
    sites = np.array([[1.2, 1.2, 0.0], [3.0, 3.0, 0.0]])
    moved = sites_in_cells(grid, volume, sites)
    assert volume[tuple(grid.nearest(moved[:1])[0])] == 0
    np.testing.assert_array_equal(moved[1], sites[1])
