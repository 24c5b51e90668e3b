"""The separating surface: zero level set of the field, clipped exactly to the domain and brought back to metres.

The only marching cubes of the project (Lewiner et al. 2003, by scikit-image) and, with the wall's offset surfaces, the
only conversion from the unit cube back to metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np
from numpy.typing import NDArray
from skimage import measure

from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import EmptySurface
from dualms.grid import Grid
from dualms.nearest import Nearest
from dualms.triangles import TriangleMesh

Values = NDArray[np.float32]


@dataclass(frozen=True)
class Surface:
    """The clipped separating surface.

    Parameters
    ----------
    mesh
        Open mesh in metres; its normals point to the cold side.
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

    mesh: TriangleMesh
    nearest: Nearest
    distance: Values
    depth: Values
    grid: Grid
    band: float


def extract_surface(
    domain: Domain, values: Values, grid: Grid, band: float, shell: float = 0.0, outside: float | None = None
) -> Surface:
    """Take the zero level set of a field inside the domain.

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
        Distance from the envelope, on both sides, up to which exact distances to the envelope are wanted.
    outside
        How far outside the envelope exact distances to the surface are wanted, but for two voxels; default ``shell``.

    Raises
    ------
    EmptySurface
        If the field has one sign in the whole domain.
    """
    wanted = (shell if outside is None else outside) + 3 * grid.spacing
    farthest = wanted + band + 0.5 * grid.spacing
    depth = domain.depth(grid, max(farthest + 0.5 * grid.spacing, shell + 4 * grid.spacing))
    # What lies further out is nobody's: a domain that bends fills half of its box.
    whole = level_set(np.where(depth > -farthest, values, -np.abs(values).max()), grid)
    if len(whole.faces) == 0:
        raise _empty()
    nearest = Nearest(whole)
    distance = signed_distance(nearest, values, grid, band, depth > -wanted)
    hot = Solid.of(whole)
    clipped, origin = (hot & Solid.of(TriangleMesh(domain.vertices, domain.faces))).faces_by_origin()
    part = clipped.part(origin == hot.origin)
    if len(part.faces) == 0:
        raise _empty()
    return Surface(to_metres(domain, part), nearest, distance, depth, grid, band)


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


def signed_distance(nearest: Nearest, values: Values, grid: Grid, band: float, wanted: NDArray[np.bool_]) -> Values:
    """Exact distance to a surface on a grid, signed by ``values`` and clipped to ±band.

    Computed only at ``wanted`` voxels that may lie within the band; elsewhere it is ±band.
    """
    positive = values > 0
    near = np.zeros(grid.shape, dtype=bool)
    for axis in range(3):
        change = np.diff(positive, axis=axis)
        near |= np.pad(change, [(0, 1) if k == axis else (0, 0) for k in range(3)])
        near |= np.pad(change, [(1, 0) if k == axis else (0, 0) for k in range(3)])
    reach = wanted & (edt.edt(~near, parallel=0) <= band / grid.spacing + 1.0)
    distance = np.where(positive, band, -band).astype(np.float32)
    exact = np.minimum(nearest.distance(grid.points(reach)), band)
    distance[reach] = np.where(positive[reach], exact, -exact)
    return distance


def to_metres(domain: Domain, mesh: TriangleMesh) -> TriangleMesh:
    """A mesh of the unit-cube frame, in metres."""
    return mesh.moved(domain.scale_m, domain.offset_m)


def _empty() -> EmptySurface:
    return EmptySurface(
        "The field has the same sign in the whole domain: one fluid fills it.",
        advice="Use more sites, or check that both fluids' ports open into the domain.",
    )
