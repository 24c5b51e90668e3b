"""The separating surface: zero level set of the field, clipped exactly to the domain and brought back to metres.

The only marching cubes of the project (Lewiner et al. 2003, by scikit-image) and, with the wall's offset surfaces, the
only conversion from the unit cube back to metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import edt
import numpy as np
from numpy.typing import NDArray
from skimage import measure

from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import EmptySurface
from dualms.grid import Grid
from dualms.narrow_band import band_distance
from dualms.nearest import Nearest
from dualms.triangles import TriangleMesh

Values = NDArray[np.float32]


@dataclass(frozen=True)
class Sheet:
    """The separating surface as walls need it: distances to it, as far out of the envelope as they are wanted.

    Parameters
    ----------
    nearest
        Of the surface as far outside the envelope as distances are exact and ``band`` more, unit-cube frame.
    distance
        Signed distance to that on ``grid``, unit-cube units, positive on the hot side, clipped to ±``band``.
    depth
        Signed distance to the envelope on ``grid``, positive inside, clipped to a band of its own.
    grid
        Their grid, unit-cube frame.
    band
        Where ``distance`` is exact.
    """

    nearest: Nearest
    distance: Values
    depth: Values
    grid: Grid
    band: float


@dataclass(frozen=True)
class Surface(Sheet):
    """The separating surface.

    Parameters
    ----------
    mesh
        Clipped to the domain: an open mesh in metres; its normals point to the cold side.
    """

    mesh: TriangleMesh


def extract_surface(
    domain: Domain, values: Values, grid: Grid, band: float, shell: float = 0.0, outside: float | None = None
) -> Surface:
    """Take the zero level set of a field inside the domain.

    Parameters
    ----------
    domain, values, grid, band, shell, outside
        As for :func:`extract_sheet`.

    Raises
    ------
    EmptySurface
        If the field has one sign in the whole domain.
    """
    sheet = extract_sheet(domain, values, grid, band, shell, outside)
    return Surface(**vars(sheet), mesh=clipped(domain, sheet))


def clipped(domain: Domain, sheet: Sheet) -> TriangleMesh:
    """The part of the separating surface in the domain, cut exactly: an open mesh in metres.

    Raises
    ------
    EmptySurface
        If there is none.
    """
    hot = Solid.of(sheet.nearest.mesh)
    cut, origin = (hot & Solid.of(domain.boundary)).faces_by_origin()
    part = cut.part(origin == hot.origin)
    if len(part.faces) == 0:
        raise _empty()
    return to_metres(domain, part)


def extract_sheet(
    domain: Domain, values: Values, grid: Grid, band: float, shell: float = 0.0, outside: float | None = None
) -> Sheet:
    """Take the zero level set of a field in the domain and a little outside it, with distances.

    Parameters
    ----------
    domain
        The envelope.
    values
        (nx, ny, nz) the field on ``grid``: positive hot, negative cold.
    grid
        Must cover the domain.
    band
        Half width in which exact distances to the surface are wanted, unit-cube units.
    shell
        How far inside the envelope exact distances to the envelope are wanted, but for two voxels.
    outside
        How far outside the envelope exact distances to it and to the surface are wanted, but for two voxels; default
        ``shell``.

    Raises
    ------
    EmptySurface
        If the field has one sign in the domain's voxels.
    """
    outside = shell if outside is None else outside
    wanted = outside + 3 * grid.spacing
    depth = domain.depth(grid, max(shell + 2 * grid.spacing, wanted + 1.5 * grid.spacing))
    hot = values[depth > 0] > 0
    if hot.all() or not hot.any():
        raise _empty()
    # What lies further out is nobody's: a domain that bends fills half of its box.
    farthest = (wanted + band) / grid.spacing + 1.5
    # Marching cubes closes the level set at the rim of the grid: keep that rim as far out.
    low, high = domain.bounds
    last = grid.origin + grid.spacing * (np.array(grid.shape) - 1)
    more = max(ceil(farthest - float(min((low - grid.origin).min(), (last - high).min())) / grid.spacing), 0)
    near = edt.edt(np.pad(depth <= 0, more, constant_values=True), parallel=0) < farthest
    whole = level_set(np.where(near, np.pad(values, more, mode="edge"), -np.abs(values).max()), grid.padded(more))
    return Sheet(Nearest(whole), signed_distance(whole, values, grid, band), depth, grid, band)


def level_set(values: Values, grid: Grid, level: float = 0.0) -> TriangleMesh:
    """Closed boundary of {values > level} on a grid, capped at the grid's outermost voxels, normals outward.

    Parameters
    ----------
    values
        (nx, ny, nz) samples.
    grid
        Their grid.
    level
        The isovalue.

    Returns
    -------
    TriangleMesh
        In the grid's frame; empty where the values never exceed the level.
    """
    values = np.array(values - np.float32(level), dtype=np.float32)
    scale: float = max(float(np.abs(values).max()), 1e-30)
    # A value of exactly zero would put several vertices on one grid point: triangles without area.
    tiny = np.float32(1e-5 * min(scale, grid.spacing))
    values = np.where(np.abs(values) < tiny, np.where(values > 0, tiny, -tiny), values)
    cap = np.float32(-scale)
    for axis in range(3):
        edge: list[slice | list[int]] = [slice(None)] * 3
        edge[axis] = [0, -1]
        values[tuple(edge)] = np.minimum(values[tuple(edge)], cap)
    if not (values > 0).any():
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    vertices, faces, _, _ = measure.marching_cubes(values, 0.0, gradient_direction="ascent", allow_degenerate=False)
    return TriangleMesh(grid.origin + grid.spacing * vertices.astype(np.float64), faces.astype(np.int64))


def signed_distance(mesh: TriangleMesh, values: Values, grid: Grid, band: float) -> Values:
    """Exact distance to a level set's mesh on a grid, signed by ``values`` and clipped to ±band."""
    distance = band_distance(mesh, grid, band)
    return np.where(values > 0, distance, -distance).astype(np.float32)


def to_metres(domain: Domain, mesh: TriangleMesh) -> TriangleMesh:
    """A mesh of the unit-cube frame, in metres."""
    return mesh.moved(domain.scale_m, domain.offset_m)


def _empty() -> EmptySurface:
    return EmptySurface(
        "The field has the same sign in the whole domain: one fluid fills it.",
        advice="Use more sites, or check that both fluids' ports open into the domain.",
    )
