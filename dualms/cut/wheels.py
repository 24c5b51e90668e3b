"""Odd bicycle wheels of a graph: the inequalities that make the bound of a cut tight where sites are packed in space.

A bicycle wheel is an edge between two hubs, a ring of p sites that all neighbour both hubs, and the spokes. For odd p
at most 2p of its 3p + 1 edges can be cut (Barahona, Grötschel and Mahjoub 1985). The edges of a Delaunay
tetrahedralisation have rings of about five neighbours, so there are about as many wheels as edges; triangles
alone allow two thirds of every wheel to be cut.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

RINGS = (3, 5)


def wheels(edges: NDArray[np.int64], count: int, ring: int) -> NDArray[np.int64]:
    """Every bicycle wheel with a ring of some length.

    Parameters
    ----------
    edges
        (E, 2) pairs of sites.
    count
        Number of sites.
    ring
        Sites of a ring, odd.

    Returns
    -------
    (W, 3 ring + 1)
        Indices of the wheel's edges.
    """
    neighbours: list[set[int]] = [set() for _ in range(count)]
    index: dict[tuple[int, int], int] = {}
    for k, (i, j) in enumerate(edges.tolist()):
        neighbours[i].add(j)
        neighbours[j].add(i)
        index[i, j] = index[j, i] = k
    found = []
    for i, j in edges.tolist():
        for cycle in cycles(neighbours, neighbours[i] & neighbours[j], ring):
            spokes = [(hub, site) for hub in (i, j) for site in cycle]
            around = zip(cycle, (*cycle[1:], cycle[0]), strict=True)
            found.append([index[pair] for pair in ((i, j), *spokes, *around)])
    return np.array(found, dtype=np.int64).reshape(-1, 3 * ring + 1)


def cycles(neighbours: list[set[int]], sites: set[int], length: int) -> Iterator[tuple[int, ...]]:
    """Every cycle of a length among some sites, once: from its smallest site, towards the smaller of its neighbours."""
    near = {site: neighbours[site] & sites for site in sites}

    def go_on(path: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(path) == length:
            if path[0] in near[path[-1]] and path[1] < path[-1]:
                yield path
            return
        for site in sorted(near[path[-1]]):
            if site > path[0] and site not in path:
                yield from go_on((*path, site))

    for site in sorted(sites):
        yield from go_on((site,))
