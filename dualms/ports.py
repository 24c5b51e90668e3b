"""Ports: parts of the domain's boundary where a fluid enters or leaves, resolved to points on the boundary.

A port is given by geometry (disk, box, facet) and resolved to quasi-uniform samples of the boundary part that it
covers, so that every later stage, whatever its grid, asks the same question: how far is the nearest sample?
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.boundary import boundary_samples
from dualms.errors import InvalidSpec, OverlappingPorts, PortNotOnBoundary
from dualms.mesh import DomainMesh
from dualms.spec import BoxPort, DiskPort, FacetPort, FluidsSpec, PortSpec, Unit

Array = NDArray[np.float64]

SAME_SIDE = float(np.cos(np.radians(45)))  # what turns from a port's mean normal by more does not open
FACING = float(np.cos(np.radians(40)))  # clearly less, whatever the samples: an edge's two faces turn by 45°
LEAST_FACING = 0.2  # of a port's area; a whole hemisphere has 0.23

SHARE = "Move them apart, or give both fluids exactly the same port to share the opening."
APART = "Move them apart, or make them one port."


@dataclass(frozen=True)
class Port:
    """One opening of the boundary.

    Parameters
    ----------
    name
        ``hot-inlet-0`` and so on: fluid, role, index in the specification.
    fluid
        1 hot, -1 cold.
    inlet
        Whether the fluid enters here.
    shared
        Whether the other fluid lists the same part of the boundary: then the sign of the field divides it.
    samples
        (S, 3) float64, quasi-uniform on the covered boundary.
    center, normal
        (3,) mean point, and mean outward unit normal.
    area
        Covered area.
    triangles
        (K,) int64 faces of the domain mesh that the port touches.
    shape
        ``disk``, ``box`` or ``facet``.
    extent
        (2, 3): a disk's centre and (radius, 0, 0); a box's corners; a facet's bounding box.
    """

    name: str
    fluid: int
    inlet: bool
    shared: bool
    samples: Array
    center: Array
    normal: Array
    area: float
    triangles: NDArray[np.int64]
    shape: str
    extent: Array

    def __post_init__(self) -> None:
        if self.fluid not in (1, -1) or self.samples.ndim != 2 or len(self.samples) == 0:
            raise ValueError("a port belongs to fluid 1 or -1 and has samples (S, 3)")

    @property
    def radius(self) -> float:
        """Radius of the disk of the same area."""
        return float(np.sqrt(self.area / np.pi))

    def lateral(self, points: Array) -> Array:
        """(P,) how far points (P, 3) lie inside the straight prism over the port, along its normal.

        Positive inside; a facet has no outline of its own, it ends where the boundary turns: infinity.
        """
        if self.shape == "disk":
            offset = points - self.extent[0]
            across = offset - np.outer(offset @ self.normal, self.normal)
            return np.asarray(self.extent[1, 0] - np.linalg.norm(across, axis=1), dtype=float)
        if self.shape == "box":
            sides = [k for k in range(3) if k != int(np.abs(self.normal).argmax())]
            inside = np.minimum(points - self.extent[0], self.extent[1] - points)
            return np.asarray(inside[:, sides].min(axis=1), dtype=float)
        return np.full(len(points), np.inf)

    def mapped(self, offset: Array, scale: float) -> Port:
        """The port with points moved by ``-offset`` and divided by ``scale``."""
        shift = np.stack([offset, np.zeros(3) if self.shape == "disk" else offset])
        return replace(
            self,
            samples=(self.samples - offset) / scale,
            center=(self.center - offset) / scale,
            area=self.area / scale**2,
            extent=(self.extent - shift) / scale,
        )


def resolve_ports(mesh: DomainMesh, fluids: FluidsSpec, units: Unit) -> tuple[Port, ...]:
    """Find the boundary part of every port, in metres.

    Parameters
    ----------
    mesh
        The envelope.
    fluids
        The specification's ports, in ``units``.
    units
        Unit of the specification's lengths.

    Returns
    -------
    tuple of Port
        Hot before cold, inlets before outlets.

    Raises
    ------
    PortNotOnBoundary
        If a port covers no part of the boundary.
    OverlappingPorts
        If two ports cover the same place and are not one shared opening.
    InvalidSpec
        If a facet's index is out of range, or a port lies over an edge or a corner and faces nowhere.
    """
    listed = [
        (f"{fluid}-{role}-{k}", 1 if fluid == "hot" else -1, role == "inlet", spec)
        for fluid, value in (("hot", fluids.hot), ("cold", fluids.cold))
        for role, specs in (("inlet", value.inlets), ("outlet", value.outlets))
        for k, spec in enumerate(specs)
    ]
    reached = np.any([_within_reach(mesh, spec, units, name) for name, *_, spec in listed], axis=0)
    samples, triangle, sample_area = boundary_samples(mesh, reached)
    ports = []
    for name, fluid, inlet, spec in listed:
        covered = _covered(mesh, spec, samples, triangle, units, name)
        shared = any(other == spec and sign != fluid for _, sign, _, other in listed)
        shares = sample_area[covered]
        center, normal, area = _mean(name, samples[covered], mesh.normals[triangle[covered]], shares)
        _refuse_turning(name, mesh.normals[triangle[covered]] @ normal, shares)
        shape, extent = _extent(mesh, spec, units)
        touched = np.unique(triangle[covered])
        ports.append(Port(name, fluid, inlet, shared, samples[covered], center, normal, area, touched, shape, extent))
    _refuse_overlaps(ports, [spec for *_, spec in listed], mesh)
    return tuple(ports)


def _within_reach(mesh: DomainMesh, spec: PortSpec, units: Unit, name: str) -> NDArray[np.bool_]:
    """(F,) which triangles a port may cover: its facet's, or those whose bounding boxes meet its own."""
    if isinstance(spec, FacetPort):
        if spec.facet >= len(mesh.facets):
            raise InvalidSpec(
                f"Port {name} names facet {spec.facet}, but the domain has {len(mesh.facets)} planar facets.",
                advice="Look the index up with `dualms inspect` or in the domain's record.",
                measured={"port": name, "facets": len(mesh.facets)},
            )
        reached = np.zeros(len(mesh.faces), dtype=bool)
        reached[mesh.facets[spec.facet].triangles] = True
        return reached
    if isinstance(spec, DiskPort):
        low, high = (np.array(spec.center) * units.metres + sign * spec.radius * units.metres for sign in (-1, 1))
    else:
        low, high = np.array(spec.box) * units.metres
    corners = mesh.vertices_m[mesh.faces]
    slack = _slack(mesh)
    return np.asarray(((corners.max(axis=1) >= low - slack) & (corners.min(axis=1) <= high + slack)).all(axis=1))


def _covered(
    mesh: DomainMesh, spec: PortSpec, samples: Array, triangle: NDArray[np.int64], units: Unit, name: str
) -> NDArray[np.int64]:
    """Indices of the samples that a port covers."""
    if isinstance(spec, FacetPort):
        found = np.flatnonzero(np.isin(triangle, mesh.facets[spec.facet].triangles))
    elif isinstance(spec, DiskPort):
        center = np.array(spec.center) * units.metres
        radius = spec.radius * units.metres
        found = np.flatnonzero(((samples - center) ** 2).sum(axis=1) <= radius**2)
        found = found[_facing(mesh.normals[triangle[found]], samples[found], center)]
    else:
        low, high = np.array(spec.box) * units.metres
        slack = _slack(mesh)
        found = np.flatnonzero(((samples >= low - slack) & (samples <= high + slack)).all(axis=1))
    if len(found) == 0:
        gap, nearest = _gap(spec, boundary_samples(mesh)[0], units)
        raise PortNotOnBoundary(
            f"Port {name} covers no part of the domain's boundary; the nearest boundary point, "
            f"{np.round(nearest / units.metres, 6).tolist()} {units.value}, is {gap / units.metres:.4g} "
            f"{units.value} away from it.",
            advice="Move the port onto the boundary or enlarge it; `dualms inspect` lists the planar facets.",
            measured={"port": name, "gap_m": gap},
        )
    return found


def _slack(mesh: DomainMesh) -> float:
    """How far a port's box may miss the boundary: it may lie in the plane of a face."""
    return 1e-6 * float(np.ptp(mesh.vertices_m, axis=0).max())


def _facing(normals: Array, samples: Array, center: Array) -> NDArray[np.bool_]:
    """Samples whose normal is within 60° of the normal at the disk's centre: a disk does not reach round an edge."""
    if len(samples) == 0:
        return np.zeros(0, dtype=bool)
    at_center = ((samples - center) ** 2).sum(axis=1).argmin()
    return np.asarray(normals @ normals[at_center] > 0.5)


def _gap(spec: PortSpec, samples: Array, units: Unit) -> tuple[float, Array]:
    """Distance (m) from a port's geometry to the nearest boundary sample, and that sample (m)."""
    if isinstance(spec, DiskPort):
        distance = np.linalg.norm(samples - np.array(spec.center) * units.metres, axis=1) - spec.radius * units.metres
    elif isinstance(spec, BoxPort):
        low, high = np.array(spec.box) * units.metres
        distance = np.linalg.norm(samples - np.clip(samples, low, high), axis=1)
    else:
        return 0.0, samples[0]
    k = int(distance.argmin())
    return float(distance[k]), samples[k]


def _mean(name: str, samples: Array, normals: Array, shares: Array) -> tuple[Array, Array, float]:
    """Mean point, mean unit normal and area of samples that stand for areas ``shares``."""
    area = float(shares.sum())
    normal = (normals * shares[:, None]).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if length < 1e-3 * area:
        raise InvalidSpec(
            f"Port {name} covers boundary parts that face in opposite directions, so it has no direction of flow.",
            advice="Make the port smaller, or give the parts as separate ports.",
            measured={"port": name},
        )
    return np.average(samples, axis=0, weights=shares), normal / length, area


def _refuse_turning(name: str, facing: Array, shares: Array) -> None:
    """A port needs a face to open through: enough of it must turn from its mean normal by clearly less than 45°."""
    share = float(shares[facing > FACING].sum() / shares.sum())
    if share < LEAST_FACING:
        raise InvalidSpec(
            f"Port {name} lies over an edge or a corner of the domain: {100 * share:.3g} % of its area turns from its "
            "mean direction by less than 40°.",
            advice="Keep the port to one face, or give each face a port of its own.",
            measured={"port": name, "facing": share},
        )


def _extent(mesh: DomainMesh, spec: PortSpec, units: Unit) -> tuple[str, Array]:
    if isinstance(spec, DiskPort):
        return "disk", np.array([spec.center, (spec.radius, 0.0, 0.0)]) * units.metres
    if isinstance(spec, BoxPort):
        return "box", np.array(spec.box) * units.metres
    points = mesh.vertices_m[mesh.faces[mesh.facets[spec.facet].triangles]].reshape(-1, 3)
    return "facet", np.stack([points.min(axis=0), points.max(axis=0)])


def _refuse_overlaps(ports: list[Port], specs: list[PortSpec], mesh: DomainMesh) -> None:
    """Ports may coincide only as one opening that both fluids list."""
    tolerance = 1e-9 * float(np.ptp(mesh.vertices_m, axis=0).max())
    for (a, spec_a), (b, spec_b) in combinations(zip(ports, specs, strict=True), 2):
        if spec_a == spec_b and a.fluid != b.fluid:
            continue
        if _apart(a.samples, b.samples, tolerance):
            continue
        distance, _ = cKDTree(b.samples).query(a.samples, distance_upper_bound=tolerance)
        common = int(np.isfinite(distance).sum())
        if common:
            share = common / min(len(a.samples), len(b.samples))
            raise OverlappingPorts(
                f"Ports {a.name} and {b.name} overlap on {100 * share:.3g} % of the smaller one.",
                advice=SHARE if a.fluid != b.fluid else APART,
                measured={"ports": [a.name, b.name], "overlap": share},
            )


def _apart(a: Array, b: Array, tolerance: float) -> bool:
    """Whether the bounding boxes of two sets of points keep more than a tolerance apart."""
    gap = np.maximum(a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0))
    return bool((gap > tolerance).any())
