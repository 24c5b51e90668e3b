"""Triply periodic surfaces as fields on a grid: the baselines that a design is compared with.

Nodal (leading-term) level sets as in von Schnering and Nesper 1991, "Nodal surfaces of Fourier series". They are near
the minimal surfaces of the same name but not equal to them (Schwarz P: area +0.3 %, I-WP: +2.6 %).
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dualms.grid import Array, Grid

Kind = Literal["gyroid", "p", "d", "iwp"]
KINDS: tuple[Kind, ...] = get_args(Kind)

AREA: dict[Kind, float] = {"gyroid": 3.0919, "p": 2.3526, "d": 3.8402, "iwp": 3.5550}
"""Area of the nodal surface in a cubic cell of edge 1, measured by marching cubes at 1/256 (a test repeats it)."""


def tpms_field(kind: Kind, grid: Grid, cell: float, origin: Array | None = None) -> NDArray[np.float32]:
    """Sample a nodal surface's field.

    Parameters
    ----------
    kind
        Which surface.
    grid
        Where to sample.
    cell
        Edge of the cubic cell, in the grid's units.
    origin
        (3,) corner of a cell; the frame's origin by default.

    Returns
    -------
    (nx, ny, nz) float32
        Level-set values (no distance); positive on one side, negative on the other.
    """
    if not cell > 0:
        raise ValueError("a cell needs a positive edge")
    corner = np.zeros(3) if origin is None else origin
    angle = [2 * np.pi * (axis - o) / cell for axis, o in zip(grid.axes(), corner, strict=True)]
    x, y, z = np.meshgrid(*angle, indexing="ij", sparse=True)
    return np.asarray(_FORMULAS[kind](x, y, z), dtype=np.float32)


def _gyroid(x: Array, y: Array, z: Array) -> Array:
    return np.asarray(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x))


def _p(x: Array, y: Array, z: Array) -> Array:
    return np.asarray(np.cos(x) + np.cos(y) + np.cos(z))


def _d(x: Array, y: Array, z: Array) -> Array:
    return np.asarray(np.cos(x) * np.cos(y) * np.cos(z) - np.sin(x) * np.sin(y) * np.sin(z))


def _iwp(x: Array, y: Array, z: Array) -> Array:
    first = np.cos(x) * np.cos(y) + np.cos(y) * np.cos(z) + np.cos(z) * np.cos(x)
    return np.asarray(2 * first - np.cos(2 * x) - np.cos(2 * y) - np.cos(2 * z))


_FORMULAS = {"gyroid": _gyroid, "p": _p, "d": _d, "iwp": _iwp}
