"""Named patches of a fluid's boundary: interface to the other fluid, wall, and one for each port."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.boundary import SAMPLES_ACROSS
from dualms.grid import thinned
from dualms.ports import Port
from dualms.triangles import TriangleMesh

INTERFACE, WALL = 0, 1


def patch_names(ports: list[Port]) -> tuple[str, ...]:
    """Names in the order of the indices that :func:`patch_of_faces` gives."""
    return ("interface", "wall", *(port.name.split("-", 1)[1] for port in ports))


def patch_of_faces(
    mesh: TriangleMesh,
    origin: NDArray[np.int64],
    interface: int,
    outline: int,
    pipes: dict[int, int],
    ports: list[Port],
    shell: float,
) -> NDArray[np.int64]:
    """Index of each face's patch.

    Parameters
    ----------
    mesh
        Boundary of one fluid, unit-cube frame.
    origin
        (F,) body that each face was cut from.
    interface, outline
        Origins of the offset surface and of the body's outline (the envelope, or the shell outside it).
    pipes
        Origin of a header's pipe to its port's place in ``ports``. Any other origin is the shell or a bore.
    ports
        The fluid's ports.
    shell
        Thickness of the shell; with one, everything on the outline is a port.

    Returns
    -------
    (F,) int64
        0 interface, 1 wall, 2 and up the ports in order.
    """
    patch = np.where(origin == interface, INTERFACE, WALL).astype(np.int64)
    for pipe, port in pipes.items():
        patch[origin == pipe] = 2 + port
    outer = np.flatnonzero(origin == outline)
    bare = [k for k in range(len(ports)) if k not in pipes.values()]
    if len(outer) == 0 or not bare:
        return patch
    middle = mesh.centroids[outer]
    step = 1.0 / SAMPLES_ACROSS
    gaps = np.stack([cKDTree(thinned(ports[k].samples, step / 2)).query(middle)[0] for k in bare])
    nearest = np.array(bare)[gaps.argmin(axis=0)]
    reach = np.inf if shell else 2 * step
    patch[outer] = np.where(gaps.min(axis=0) <= reach, 2 + nearest, WALL)
    return patch
