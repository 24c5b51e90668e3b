"""Periodic surfaces in a design's envelope, with the cell size that makes the comparison fair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualms.body.header import Header
from dualms.cfd.channels import VoxelExchanger, solid_share, voxelise
from dualms.domain import Domain
from dualms.grid import Grid
from dualms.surface import level_set, signed_distance
from dualms.tpms import AREA, Kind, tpms_field

Values = NDArray[np.float32]

BAND_VOXELS = 3.0  # exact distances so far from the wall: voxels next to it, and their differences
UA_EXPONENT, PRESSURE_EXPONENT = -0.95, -1.4  # of the cell size, for a gyroid: where one solution must do


@dataclass(frozen=True)
class PowerLaw:
    """UA and ΔP of one kind of surface as powers of its cell size, fitted to solved points.

    Parameters
    ----------
    cells, ua_w_k, pressure_pa
        (K,) solved points.
    """

    cells: tuple[float, ...]
    ua_w_k: tuple[float, ...]
    pressure_pa: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.cells) == len(self.ua_w_k) == len(self.pressure_pa) > 0:
            raise ValueError("a power law needs as many cells as results, at least one")
        if min(*self.cells, *self.ua_w_k, *self.pressure_pa) <= 0:
            raise ValueError("a power law needs positive values")

    def cell_at(self, ua_w_k: float) -> float:
        """Cell size of a given UA."""
        slope, offset = self._fit(self.ua_w_k, UA_EXPONENT)
        return float(np.exp((np.log(ua_w_k) - offset) / slope))

    def pressure_at(self, ua_w_k: float) -> float:
        """ΔP at the cell size of a given UA."""
        slope, offset = self._fit(self.pressure_pa, PRESSURE_EXPONENT)
        return float(np.exp(offset + slope * np.log(self.cell_at(ua_w_k))))

    def _fit(self, values: tuple[float, ...], assumed: float) -> tuple[float, float]:
        """Slope and offset in logarithms; the assumed slope where the points do not span enough to tell."""
        x, y = np.log(self.cells), np.log(values)
        spread = ((x - x.mean()) ** 2).sum()
        slope = float(((x - x.mean()) * (y - y.mean())).sum() / spread) if spread > 1e-4 else assumed
        if not 0.3 * assumed >= slope >= 3 * assumed:
            slope = assumed
        return slope, float(y.mean() - slope * x.mean())


def exact_distance(values: NDArray[np.floating], grid: Grid, target: Grid, wall: float) -> Values:
    """Exact distance to a field's zero level set on another grid.

    Parameters
    ----------
    values, grid
        The field (or a distance) and its grid, which must cover the domain.
    target
        Where distances are wanted.
    wall
        Thickness of the separating wall.

    Returns
    -------
    (nx, ny, nz) float32
        Unit-cube units, positive where the field is; clipped to half the wall and ``BAND_VOXELS`` voxels.
    """
    band = wall / 2 + BAND_VOXELS * target.spacing
    # Marching cubes closes the level set at the rim of the grid: keep that rim out of reach.
    extra = int(np.ceil((band + target.spacing) / grid.spacing)) + 1
    padded = np.pad(np.asarray(values, dtype=np.float32), extra, mode="edge")
    surface = level_set(padded, grid.padded(extra))
    sampled = grid.sample(values, target.points()).reshape(target.shape).astype(np.float32)
    return signed_distance(surface, sampled, target, band)


def tpms_distance(kind: Kind, cell: float, target: Grid, wall: float) -> Values:
    """Exact distance to a periodic surface of a cell size (unit-cube units), as :func:`exact_distance`."""
    return exact_distance(tpms_field(kind, target, cell), target, target, wall)


def tpms_exchanger(
    domain: Domain,
    kind: Kind,
    cell: float,
    grid: Grid,
    wall: float,
    shell: float = 0.0,
    headers: tuple[Header, ...] = (),
    skin: float = 0.0,
) -> VoxelExchanger:
    """A periodic surface of a cell size (unit-cube units) as an exchanger in the envelope."""
    return voxelise(domain, tpms_distance(kind, cell, grid, wall), grid, wall, shell, headers, skin)


def cell_of_solid_fraction(domain: Domain, kind: Kind, grid: Grid, wall: float, fraction: float) -> float:
    """Cell size (unit-cube units) at which a periodic surface's wall takes a share of the envelope, within 1 %.

    The same wall thickness: an equal share means an equal area. Starts from the share in full space, wall · area/cell.
    """
    inside = domain.inside(grid)
    cell = wall * AREA[kind] / fraction
    for _ in range(4):
        distance = tpms_distance(kind, cell, grid, wall)
        found = solid_share(distance[inside], wall, grid.spacing)
        if abs(found / fraction - 1) < 0.01:
            break
        cell *= found / fraction
    return cell
