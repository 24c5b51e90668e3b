"""Named patches of a fluid's boundary: interface to the other fluid, wall, and one for each port."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.ports import SAMPLES_ACROSS, Port
from dualms.triangles import TriangleMesh

INTERFACE, WALL = 0, 1


def patch_names(ports: list[Port]) -> tuple[str, ...]:
    """Names in the order of the indices that :func:`patch_of_faces` gives."""
    return ("interface", "wall", *(port.name.split("-", 1)[1] for port in ports))


def patch_of_faces(
    mesh: TriangleMesh,
    origin: NDArray[np.int64],
    interface: int,
    envelope: int,
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
    interface, envelope
        Origins of the offset surface and of the envelope; any other origin is the shell.
    ports
        The fluid's ports.
    shell
        Thickness of the shell; with one, everything on the envelope is a port.

    Returns
    -------
    (F,) int64
        0 interface, 1 wall, 2 and up the ports in order.
    """
    patch = np.where(origin == interface, INTERFACE, WALL).astype(np.int64)
    outer = np.flatnonzero(origin == envelope)
    if len(outer) == 0:
        return patch
    middle = mesh.centroids[outer]
    gaps = np.stack([cKDTree(port.samples).query(middle)[0] for port in ports])
    nearest = gaps.argmin(axis=0)
    reach = np.inf if shell else 2.0 / SAMPLES_ACROSS
    patch[outer] = np.where(gaps.min(axis=0) <= reach, 2 + nearest, WALL)
    return patch
