"""The design domain in the unit-cube frame (longest side 1): the only way in from metres.

Inside test and signed distance follow Barill et al. 2018, "Fast winding numbers for soups and clouds", by libigl.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from dualms.booleans import Solid
from dualms.errors import DisconnectedDomain
from dualms.grid import Array, Grid, thinned
from dualms.mesh import DomainMesh
from dualms.narrow_band import band_distance
from dualms.nearest import Nearest
from dualms.ports import Port
from dualms.triangles import TriangleMesh

LONGEST_EDGE = 1 / 64  # of the triangles that winding numbers are taken from, unit-cube units
FEW = 50  # triangles: so many are summed sooner one by one
EDGE_OVER_BAND = 4  # a triangle's box of edge L + 2B holds fewest voxels for its area L² at L = 4B
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Domain:
    """A closed body in the unit-cube frame, with its ports.

    Parameters
    ----------
    vertices
        (V, 3) float64 in [0, 1]³; the longest side of the bounding box is 1, the lower corner 0.
    faces
        (F, 3) int64, oriented outward.
    scale_m
        Metres per unit: the longest side.
    offset_m
        (3,) metres of the unit frame's origin.
    ports
        In the unit-cube frame, hot before cold and inlets before outlets.
    """

    vertices: Array
    faces: NDArray[np.int64]
    scale_m: float
    offset_m: Array
    ports: tuple[Port, ...]

    @classmethod
    def from_mesh(cls, mesh: DomainMesh, ports: tuple[Port, ...]) -> Domain:
        """Map a mesh and its ports from metres to the unit cube."""
        low = mesh.vertices_m.min(axis=0)
        scale = float((mesh.vertices_m.max(axis=0) - low).max())
        moved = tuple(port.mapped(low, scale) for port in ports)
        return cls((mesh.vertices_m - low) / scale, mesh.faces, scale, low, moved)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,)."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def volume(self) -> float:
        """Volume in unit-cube units."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    @property
    def boundary(self) -> TriangleMesh:
        """The envelope's closed mesh."""
        return TriangleMesh(self.vertices, self.faces)

    @cached_property
    def _nearest(self) -> Nearest:
        return Nearest(self.boundary)

    @cached_property
    def _fine(self) -> TriangleMesh:
        """The boundary for winding numbers: near long thin triangles they cost up to ten times more."""
        return self.boundary if len(self.faces) <= FEW else self._split(LONGEST_EDGE)

    def _split(self, edge: float) -> TriangleMesh:
        """The boundary in triangles with edges of at most a length."""
        return Solid(Solid.of(self.boundary).manifold.refine_to_length(edge), -1).mesh()

    def grid(self, resolution: int, padding: int = 3) -> Grid:
        """A grid of spacing 1/resolution that covers the domain."""
        return Grid.around(*self.bounds, resolution, padding)

    def contains(self, points: Array) -> Mask:
        """(P,) whether points (P, 3) lie inside."""
        if len(points) == 0:
            return np.zeros(0, dtype=bool)
        winding = igl.fast_winding_number(self._fine.vertices, self._fine.faces, np.ascontiguousarray(points))
        return np.asarray(winding > 0.5, dtype=bool)

    def signed_distance(self, points: Array) -> Array:
        """(P,) exact distance to the boundary, positive inside."""
        if len(points) == 0:
            return np.zeros(0)
        return np.asarray(np.where(self.contains(points), 1.0, -1.0) * self._nearest.distance(points), dtype=float)

    def depth(self, grid: Grid, band: float) -> NDArray[np.float32]:
        """Signed distance to the boundary on a grid, positive inside, exact below ``band`` and clipped to ±band.

        Two neighbours on different sides of the boundary cannot both be further than half a voxel from it, so beyond
        that one inside test a connected region decides the sign.
        """
        reach = max(band, grid.spacing)
        distance = band_distance(self._split(EDGE_OVER_BAND * reach), grid, reach)
        far = distance > 0.51 * grid.spacing
        inside = np.zeros(grid.shape, dtype=bool)
        inside[~far] = self.contains(grid.points(~far))
        regions, count = ndimage.label(far)
        if count:
            boxes = ndimage.find_objects(regions)
            seeds = np.array([_first_of(regions, box, k + 1) for k, box in enumerate(boxes)])
            inside[far] = self.contains(grid.origin + grid.spacing * seeds)[regions[far] - 1]
        distance = np.minimum(distance, band)
        return np.where(inside, distance, -distance).astype(np.float32)

    def inside(self, grid: Grid) -> Mask:
        """Which voxel centres lie inside; the largest 6-connected region only where the rest is negligible.

        Raises
        ------
        DisconnectedDomain
            If a second region holds more than 2 % of the voxels: the domain has necks below the resolution.
        """
        inside = self.depth(grid, 1.5 * grid.spacing) > 0
        regions, count = ndimage.label(inside)
        if count == 0:
            raise DisconnectedDomain(
                f"No voxel of edge {grid.spacing * self.scale_m:.4g} m lies inside the domain.",
                advice="Raise the resolution or thicken the domain.",
            )
        sizes = np.bincount(regions.ravel())[1:]
        largest = int(sizes.argmax())
        rest = sizes.sum() - sizes[largest]
        if rest > 0.02 * sizes.sum():
            raise DisconnectedDomain(
                f"At voxels of {grid.spacing * self.scale_m:.4g} m the domain falls into {count} parts; "
                f"{100 * rest / sizes.sum():.1f} % of it lies outside the largest.",
                advice="Raise the resolution, or widen the domain's narrowest neck to two voxels or more.",
                measured={"parts": int(count), "voxel_m": grid.spacing * self.scale_m},
            )
        return np.asarray(regions == largest + 1)

    def port_voxels(self, grid: Grid, inside: Mask) -> tuple[NDArray[np.int64], ...]:
        """For each port the (K, 3) indices of the inside voxels that touch it, sorted; at least one each."""
        interior = np.argwhere(inside)
        tree = cKDTree(grid.origin + grid.spacing * interior)
        found = []
        for port in self.ports:
            inward = port.samples - 0.5 * grid.spacing * port.normal
            # One sample in each cube of half a voxel does: samples are much finer than most grids.
            _, nearest = tree.query(thinned(inward, 0.5 * grid.spacing))
            found.append(interior[np.unique(nearest)])
        return tuple(found)


def _first_of(regions: NDArray[np.int32], box: tuple[slice, ...], label: int) -> NDArray[np.int64]:
    """(3,) index of the first voxel of a labelled region, looked for in its bounding box only."""
    inside = np.unravel_index(int((regions[box] == label).argmax()), regions[box].shape)
    return np.array([s.start + i for s, i in zip(box, inside, strict=True)])
