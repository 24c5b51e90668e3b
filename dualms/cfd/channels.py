"""The two fluids' channels as voxels, with the faces where each fluid enters and leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from dualms.body.header import Header
from dualms.body.headers import at_pipe_ends
from dualms.body.thickness import GradedWall, Wall, mean_thickness, thickness_at
from dualms.boundary import SAMPLES_ACROSS
from dualms.domain import Domain
from dualms.errors import ChannelBlocked
from dualms.grid import Array, Grid
from dualms.ports import Port

Labels = NDArray[np.int8]
Index = NDArray[np.int64]

OUTSIDE, HOT, COLD, WALL = 0, 1, -1, 2
NEGLIGIBLE = 0.01  # a through-going region below this share of its fluid's voxels is dropped as a pocket
STEPS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


@dataclass(frozen=True)
class Openings:
    """Boundary faces of one fluid's voxels that lie in its ports.

    Parameters
    ----------
    inlet, outlet
        (K, 4) int64: the voxel's index along x, y, z, and the face's direction 0…5 for -x, +x, -y, +y, -z, +z; sorted.
    inlet_normals
        (K, 3) outward unit normal of the port that each inlet face belongs to.
    """

    inlet: Index
    outlet: Index
    inlet_normals: Array

    def __post_init__(self) -> None:
        if self.inlet.shape[1:] != (4,) or self.outlet.shape[1:] != (4,) or self.inlet_normals.shape[1:] != (3,):
            raise ValueError("openings are faces (K, 4) and normals (K, 3)")
        if len(self.inlet) == 0 or len(self.outlet) == 0:
            raise ValueError("a fluid needs at least one inlet face and one outlet face")


@dataclass(frozen=True)
class VoxelExchanger:
    """Both fluids on a voxel lattice, in metres.

    Parameters
    ----------
    labels
        (nx, ny, nz) int8: 0 outside the envelope, 1 hot, -1 cold, 2 separating wall (and dropped pockets). The
        outermost layer is 0.
    distance_m
        (nx, ny, nz) float32 signed distance to the separating surface, positive on the hot side; exact near it.
    spacing_m
        Edge of a voxel.
    origin_m
        (3,) centre of voxel (0, 0, 0).
    wall_m
        Thickness of the separating wall; its mean, where it is graded.
    hot, cold
        Where each fluid enters and leaves.
    dropped_hot, dropped_cold
        Share of each fluid's voxels that led from no inlet to any outlet and count as wall.
    piped
        Voxels that lie in headers, outside the envelope.
    """

    labels: Labels
    distance_m: NDArray[np.float32]
    spacing_m: float
    origin_m: Array
    wall_m: float
    hot: Openings
    cold: Openings
    dropped_hot: float
    dropped_cold: float
    piped: int = 0

    def __post_init__(self) -> None:
        if self.labels.ndim != 3 or self.labels.shape != self.distance_m.shape:
            raise ValueError("labels and distances must share a shape (nx, ny, nz)")
        if self.spacing_m <= 0 or self.wall_m < 0:
            raise ValueError("spacing must be positive and the wall not negative")
        if not np.isin(self.labels, (OUTSIDE, HOT, COLD, WALL)).all():
            raise ValueError("labels must be 0, 1, -1 or 2")
        if any(np.take(self.labels, k, axis=axis).any() for axis in range(3) for k in (0, -1)):
            raise ValueError("the outermost voxels must lie outside")

    def openings(self, fluid: int) -> Openings:
        """Openings of fluid 1 or -1."""
        return self.hot if fluid == HOT else self.cold

    def dropped(self, fluid: int) -> float:
        """Dropped share of fluid 1 or -1."""
        return self.dropped_hot if fluid == HOT else self.dropped_cold

    @property
    def solid_fraction(self) -> float:
        """Wall over envelope, both by true distance where the voxels are coarser than the wall."""
        voxels = self.distance_m[self.labels != OUTSIDE]
        share = solid_share(voxels, self.wall_m, self.spacing_m)
        return share * len(voxels) / (len(voxels) - self.piped)


def solid_share(distance: NDArray[np.floating], wall: float, spacing: float) -> float:
    """Share of voxels that a wall takes, by their distances (K,) to its middle surface.

    Voxels are coarser than the wall: each counts by the part of a ramp one voxel wide that the wall covers.
    """
    upper = np.clip((distance + wall / 2) / spacing + 0.5, 0, 1)
    lower = np.clip((distance - wall / 2) / spacing + 0.5, 0, 1)
    return float(np.mean(upper - lower))


def voxelise(
    domain: Domain,
    distance: NDArray[np.floating],
    grid: Grid,
    wall: Wall,
    shell_thickness: float = 0.0,
    headers: tuple[Header, ...] = (),
    skin: float = 0.0,
) -> VoxelExchanger:
    """Label the voxels of a domain by a signed distance, keep what leads from inlet to outlet, and find the openings.

    Parameters
    ----------
    domain
        The envelope and its ports.
    distance
        (nx, ny, nz) signed distance to the separating surface on ``grid``, unit-cube units, positive in the hot fluid.
    grid
        Must cover the domain and the headers with at least one voxel to spare on each side.
    wall
        Unit-cube units; walls thinner than a voxel leave hot and cold voxels touching, which solvers of this lattice
        take as a wall of both.
    shell_thickness
        Closed skin along the inside of the envelope, unit-cube units; ports go through it.
    headers
        Pipes on ports: they belong to the fluid, which then enters or leaves at their ends.
    skin
        Thickness of a shell outside the envelope, which the headers' lengths are measured from.

    Raises
    ------
    ChannelBlocked
        If a fluid has no path of voxels from an inlet to an outlet.
    """
    inside = domain.inside(grid)
    fluid = np.where(distance > 0, HOT, COLD).astype(np.int8)
    thickness = thickness_at(wall, grid.points()).reshape(grid.shape) if isinstance(wall, GradedWall) else wall
    labels = np.where(np.abs(distance) > thickness / 2, fluid, np.int8(WALL))
    labels[~inside] = OUTSIDE
    if shell_thickness > 0:
        depth = domain.depth(grid, shell_thickness + grid.spacing)
        covered = inside & (depth < shell_thickness)
        for sign in (HOT, COLD):
            under = _under_ports(domain, grid, sign, shell_thickness)
            labels[covered & (fluid == sign) & ~under] = OUTSIDE
    piped = np.zeros(grid.shape, dtype=bool)
    for header in headers:
        bore = header.holds(grid.points(), grid, skin).reshape(grid.shape) & ~inside
        sign = domain.ports[header.port].fluid
        labels[bore] = sign
        piped |= bore
        # Far from any wall but its own: no heat passes here.
        distance = np.where(bore, sign * np.abs(distance).max(), distance)
    ends = at_pipe_ends(domain, headers, skin)
    kept = {sign: _through(ends, grid, labels, sign) for sign in (HOT, COLD)}
    for sign, (keep, _, _) in kept.items():
        labels[(labels == sign) & ~keep] = WALL
    return VoxelExchanger(
        labels,
        np.asarray(distance * domain.scale_m, dtype=np.float32),
        grid.spacing * domain.scale_m,
        domain.offset_m + grid.origin * domain.scale_m,
        mean_thickness(wall, domain, grid) * domain.scale_m,
        kept[HOT][1],
        kept[COLD][1],
        kept[HOT][2],
        kept[COLD][2],
        int(piped.sum()),
    )


def _under_ports(domain: Domain, grid: Grid, fluid: int, depth: float) -> NDArray[np.bool_]:
    """Voxels under the fluid's ports, down to a depth."""
    under = np.zeros(grid.shape, dtype=bool)
    points = grid.points()
    for port in domain.ports:
        if port.fluid == fluid:
            distance, _ = cKDTree(port.samples).query(points, distance_upper_bound=depth + 2 * grid.spacing)
            under |= (np.isfinite(distance) & (port.lateral(points) > 0)).reshape(grid.shape)
    return under


def _through(domain: Domain, grid: Grid, labels: Labels, fluid: int) -> tuple[NDArray[np.bool_], Openings, float]:
    """Voxels of a fluid that lead from an inlet to an outlet, their openings, and the share of the rest."""
    regions, _ = ndimage.label(labels == fluid)
    inlet, normals = _port_faces(domain, grid, labels, fluid, inlet=True)
    outlet, _ = _port_faces(domain, grid, labels, fluid, inlet=False)
    sizes = np.bincount(regions.ravel())
    total = int(sizes[1:].sum())
    joined = np.intersect1d(regions[tuple(inlet[:, :3].T)], regions[tuple(outlet[:, :3].T)])
    joined = joined[sizes[joined] >= NEGLIGIBLE * max(total, 1)]
    name = "hot" if fluid == HOT else "cold"
    if len(joined) == 0:
        raise ChannelBlocked(
            f"At voxels of {grid.spacing * domain.scale_m:.3g} m no {name} channel leads from an inlet to an outlet "
            f"({len(inlet)} inlet and {len(outlet)} outlet faces found).",
            advice="Raise the evaluation's resolution, use fewer sites, or make the ports larger.",
            measured={"fluid": name, "inlet_faces": len(inlet), "outlet_faces": len(outlet)},
        )
    keep = np.isin(regions, joined)
    of_inlet, of_outlet = keep[tuple(inlet[:, :3].T)], keep[tuple(outlet[:, :3].T)]
    openings = Openings(inlet[of_inlet], outlet[of_outlet], normals[of_inlet])
    return keep, openings, 1.0 - float(sizes[joined].sum()) / total


def _port_faces(domain: Domain, grid: Grid, labels: Labels, fluid: int, inlet: bool) -> tuple[Index, Array]:
    """Faces (K, 4) of a fluid's voxels towards the outside that lie in its ports, and the ports' normals (K, 3)."""
    ports = [port for port in domain.ports if port.fluid == fluid and port.inlet == inlet]
    faces = boundary_faces(labels, fluid, (OUTSIDE,))
    centers = grid.origin + grid.spacing * (faces[:, :3] + 0.5 * STEPS[faces[:, 3]])
    owner = np.full(len(faces), -1)
    nearest = np.full(len(faces), np.inf)
    for k, port in enumerate(ports):
        distance, covered = _covered(port, centers, grid.spacing)
        covered &= (STEPS[faces[:, 3]] @ port.normal > 0.35) & (distance < nearest)
        owner[covered], nearest[covered] = k, distance[covered]
    chosen = owner >= 0
    normals = np.array([port.normal for port in ports]).reshape(-1, 3)[owner[chosen]]
    return faces[chosen], normals


def _covered(port: Port, centers: Array, spacing: float) -> tuple[Array, NDArray[np.bool_]]:
    """Distance of face centres (K, 3) to a port, and whether they lie over it, off the boundary by little."""
    distance, nearest = cKDTree(port.samples).query(centers, distance_upper_bound=2 * spacing)
    near = np.isfinite(distance)
    offset = np.zeros_like(centers)
    offset[near] = centers[near] - port.samples[nearest[near]]
    across = np.linalg.norm(offset - np.outer(offset @ port.normal, port.normal), axis=1)
    return distance, near & (across <= max(1.0 / SAMPLES_ACROSS, 0.3 * spacing))


def boundary_faces(labels: Labels, fluid: int, neighbours: tuple[int, ...]) -> Index:
    """(K, 4) faces of a fluid's voxels towards voxels labelled as one of ``neighbours``, sorted by voxel."""
    own = labels == fluid
    found = []
    for direction, step in enumerate(STEPS):
        beyond = np.isin(np.roll(labels, tuple(-step), axis=(0, 1, 2)), neighbours)
        cells = np.argwhere(own & beyond)
        found.append(np.column_stack([cells, np.full(len(cells), direction)]))
    faces = np.concatenate(found).astype(np.int64)
    return faces[np.lexsort(faces.T[::-1])]
