"""Self-support: the whole design is solved in a space that is compressed along the build direction (ours).

Cells, channels and walls that have no preferred direction there come out ``steepness`` times longer along the build
direction here, so fewer of their walls lie flatter than 45°. A map of the plane is all it takes: graph, cut, skeletons
and field are made by the same code, and lengths that must be true (wall, shell, headers) are measured afterwards.

Of a surface whose normals have no preferred direction, the share that lies flatter than 45° is 1 - 1/√2 = 0.293;
stretched by s along the build direction it falls to :func:`random_share`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dualms.domain import Domain
from dualms.field.field import Field
from dualms.field.interface import MARGIN
from dualms.field.samples import GridSamples
from dualms.flow import PAIRS, FlowField
from dualms.graph.graph import Graph
from dualms.grid import Grid
from dualms.ports import Port
from dualms.spec import SelfSupportSpec

Array = NDArray[np.float64]

NETWORK_RESOLUTION = 128  # voxels a unit at which a network is sampled to leave the compressed space


@dataclass(frozen=True)
class Compression:
    """The map from a domain's unit-cube frame to that of the compressed domain: (matrix · x - low) / scale.

    Parameters
    ----------
    matrix
        (3, 3) symmetric: 1/s along the build direction, 1 across it.
    low
        (3,) lower corner of the compressed domain.
    scale
        Its longest side, in units of the domain's.
    """

    matrix: Array
    low: Array
    scale: float

    @classmethod
    def of(cls, domain: Domain, up: Array, steepness: float) -> Compression:
        """The compression of a domain along ``up`` (3,) by a factor of at least 1."""
        if steepness < 1:
            raise ValueError("a compression makes the domain lower, not higher")
        unit = up / np.linalg.norm(up)
        matrix = np.eye(3) - (1 - 1 / steepness) * np.outer(unit, unit)
        moved = domain.vertices @ matrix
        low = moved.min(axis=0)
        return cls(matrix, low, float((moved.max(axis=0) - low).max()))

    def points(self, points: Array) -> Array:
        """Points (P, 3) of the domain's frame in the compressed one."""
        return np.asarray((points @ self.matrix - self.low) / self.scale)

    def back(self, points: Array) -> Array:
        """The inverse of :meth:`points`."""
        return np.asarray((self.scale * points + self.low) @ np.linalg.inv(self.matrix))

    def domain(self, domain: Domain) -> Domain:
        """The compressed domain with its ports."""
        return Domain(
            self.points(domain.vertices),
            domain.faces,
            domain.scale_m * self.scale,
            domain.offset_m,
            tuple(self._port(port) for port in domain.ports),
        )

    def flow(self, flow: FlowField, compressed: Domain) -> FlowField:
        """Guidance in the compressed space: lines turn with the space, their clearness stays."""
        grid = compressed.grid(round(1 / flow.grid.spacing))
        before = flow.tensors(self.back(grid.points()))
        tensors = self.matrix @ before @ self.matrix
        traces = (t.trace(axis1=1, axis2=2) for t in (before, tensors))
        tensors *= (next(traces) / np.maximum(next(traces), 1e-12))[:, None, None]
        packed = np.stack([tensors[:, i, j] for i, j in PAIRS], axis=1).astype(np.float32)
        return FlowField(grid, compressed.inside(grid), packed.reshape(*grid.shape, 6))

    def graph_back(self, graph: Graph) -> Graph:
        """A graph of the compressed space with its places in the domain's frame; weights and areas stay."""
        return replace(graph, sites=self.back(graph.sites), passages=self.back(graph.passages))

    def field_back(self, field: Field, domain: Domain, compressed: Domain) -> Field:
        """A field of the compressed space, sampled on a grid of the domain's frame by cubic splines."""
        source = field.source
        if not isinstance(source, GridSamples):
            low, high = compressed.bounds
            wide = Grid.around(low - MARGIN, high + MARGIN, NETWORK_RESOLUTION)
            source = GridSamples(wide, field.on(wide))
        resolution = round(1 / (source.grid.spacing * self.scale))
        low, high = domain.bounds
        grid = Grid.around(low - MARGIN, high + MARGIN, resolution)
        places = (self.points(grid.points()) - source.grid.origin) / source.grid.spacing
        values = ndimage.map_coordinates(source.values, places.T, order=3, mode="nearest").reshape(grid.shape)
        # Lengths of the compressed frame, so that the field stays close to a distance.
        samples = GridSamples(grid, np.asarray(values * self.scale, dtype=np.float32))
        return replace(field, source=samples)

    def _port(self, port: Port) -> Port:
        """The port, but for its outline's extent, which only the body asks for, in the domain's frame."""
        turned = np.linalg.solve(self.matrix, port.normal)
        grown = float(np.linalg.norm(turned) * np.linalg.det(self.matrix))
        return replace(
            port,
            samples=self.points(port.samples),
            center=self.points(port.center[None])[0],
            normal=turned / np.linalg.norm(turned),
            area=port.area * grown / self.scale**2,
        )


def compression(domain: Domain, spec: SelfSupportSpec | None, up: tuple[float, float, float]) -> Compression | None:
    """The compression that a specification asks for along the build direction; None for none."""
    return None if spec is None else Compression.of(domain, np.array(up, dtype=float), spec.steepness)


def random_share(steepness: float, directions: int = 100_000) -> float:
    """Share of area that lies flatter than 45° when a surface of evenly spread normals is stretched along up.

    Notes
    -----
    With z the compressed normal's component along up, a piece's area grows by √(s²(1 - z²) + z²) and lies flatter than
    45° where z² > s² (1 - z²); z is uniform on [0, 1].
    """
    z = (np.arange(directions) + 0.5) / directions
    area = np.sqrt(steepness**2 * (1 - z**2) + z**2)
    return float(area[z**2 > steepness**2 * (1 - z**2)].sum() / area.sum())
