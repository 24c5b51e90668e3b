"""Heat transfer on the frozen flow: one linear system for both fluids, coupled through the separating wall.

First-order upwind convection and central conduction on the voxels. The stair-stepped wall faces are corrected to the
true surface: a face counts for its area projected on the surface's normal, and its voxel's centre for its true distance
from the wall. A wall face exchanges heat with the nearest face on the other side, through half of each one's area, so
that what leaves one fluid enters the other. The wall is a resistance across its thickness; conduction along it is left
out, and so is conduction through inlets and outlets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from dualms.cfd.channels import STEPS, VoxelExchanger
from dualms.cfd.linear import solve_upwind
from dualms.cfd.mesh import ChannelMesh
from dualms.grid import Array
from dualms.spec import FluidSpec

NEAREST = 0.1  # a voxel's centre counts as at least this share of a voxel away from the wall


@dataclass(frozen=True)
class Stream:
    """One fluid's mesh, flow and properties.

    Parameters
    ----------
    mesh
        Its cells and faces.
    flux_m3_s
        (F,) volume flow through the faces along their normals; leaves no cell with a net outflow.
    pressure_pa
        (N,) of the cells: it falls along the flow, which the solver's numbering follows.
    fluid
        Its properties.
    """

    mesh: ChannelMesh
    flux_m3_s: Array
    pressure_pa: Array
    fluid: FluidSpec

    def __post_init__(self) -> None:
        if self.flux_m3_s.shape != self.mesh.owner.shape or not np.isfinite(self.flux_m3_s).all():
            raise ValueError("a stream needs one finite flux per face")

    @property
    def capacity_rate_w_k(self) -> float:
        """Mass flow times specific heat."""
        return self.fluid.mass_flow_kg_s * self.fluid.specific_heat_j_kg_k


@dataclass(frozen=True)
class WallFaces:
    """The wall faces of one fluid, brought to the true surface.

    Parameters
    ----------
    cell
        (K,) the voxel behind each face.
    area_m2
        (K,) area projected on the surface's normal.
    gap_m
        (K,) distance of the voxel's centre from the wall.
    foot_m
        (K, 3) nearest point of the separating surface, by the distance's gradient.
    """

    cell: NDArray[np.int64]
    area_m2: Array
    gap_m: Array
    foot_m: Array


@dataclass(frozen=True)
class HeatSolution:
    """Temperatures of one fluid and its heat balance.

    Parameters
    ----------
    temperature_k
        (N,) of the cells.
    outlet_k
        Mixed-cup temperature of what leaves.
    wall_w
        Heat that the fluid takes from the wall.
    enthalpy_w
        Gain of enthalpy from inlet to outlet.
    """

    temperature_k: Array
    outlet_k: float
    wall_w: float
    enthalpy_w: float


def wall_faces(exchanger: VoxelExchanger, mesh: ChannelMesh) -> WallFaces:
    """The wall faces of a fluid with their true areas and distances."""
    faces = mesh.patch("wall")
    cell, direction = mesh.owner[faces], mesh.direction[faces]
    index = mesh.cells[cell]
    slope = np.stack([_slope(exchanger.distance_m, index, axis) for axis in range(3)], axis=1)
    normal = slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-12)[:, None]
    distance = exchanger.distance_m[tuple(index.T)].astype(float)
    # Where the distance has a ridge (middle of a thin channel) its gradient vanishes: the face itself counts.
    flat = np.linalg.norm(slope, axis=1) < 0.3 * exchanger.spacing_m
    projected = np.abs(np.einsum("ij,ij->i", normal, STEPS[direction]))
    gap = np.abs(distance) - exchanger.wall_m / 2
    foot = exchanger.origin_m + exchanger.spacing_m * index - distance[:, None] * normal
    return WallFaces(
        cell,
        mesh.face_area_m2 * np.where(flat, 1.0, projected),
        np.clip(gap, NEAREST * mesh.spacing_m, 1.5 * mesh.spacing_m),
        foot,
    )


def exchange(
    exchanger: VoxelExchanger, hot: Stream, cold: Stream, wall_conductivity_w_m_k: float
) -> tuple[HeatSolution, HeatSolution]:
    """Solve both fluids' temperatures with the wall between them.

    Parameters
    ----------
    exchanger
        Geometry.
    hot, cold
        Solved flows.
    wall_conductivity_w_m_k
        Of the wall's material.

    Returns
    -------
    tuple of HeatSolution
        Hot, cold.
    """
    sides = (wall_faces(exchanger, hot.mesh), wall_faces(exchanger, cold.mesh))
    link_hot, link_cold, area = _links(*sides)
    resistance = (
        sides[0].gap_m[link_hot] / hot.fluid.conductivity_w_m_k
        + sides[1].gap_m[link_cold] / cold.fluid.conductivity_w_m_k
        + exchanger.wall_m / wall_conductivity_w_m_k
    )
    conductance = area / resistance
    count = len(hot.mesh.cells)
    a, b = sides[0].cell[link_hot], sides[1].cell[link_cold] + count
    blocks = [_transport(s) for s in (hot, cold)]
    inflow = np.concatenate([rhs for _, rhs in blocks])
    matrix = sparse.block_diag([m for m, _ in blocks], format="csr") + _graph(a, b, conductance, len(inflow))
    temperature = solve_upwind(matrix.tocsr(), inflow, _downstream((hot, cold)))
    taken = conductance * (temperature[a] - temperature[b])
    total = float(taken.sum())
    return (
        _solution(hot, temperature[:count], -total),
        _solution(cold, temperature[count:], total),
    )


def isothermal(exchanger: VoxelExchanger, stream: Stream, wall_k: float) -> HeatSolution:
    """Solve one fluid's temperatures with all of its wall at one temperature."""
    wall = wall_faces(exchanger, stream.mesh)
    conductance = wall.area_m2 * stream.fluid.conductivity_w_m_k / wall.gap_m
    matrix, rhs = _transport(stream)
    count = len(stream.mesh.cells)
    diagonal = np.bincount(wall.cell, conductance, minlength=count)
    matrix = (matrix + sparse.diags_array(diagonal)).tocsr()
    temperature = solve_upwind(matrix, rhs + diagonal * wall_k, _downstream((stream,)))
    return _solution(stream, temperature, float(diagonal @ (wall_k - temperature)))


def _slope(distance: NDArray[np.float32], index: NDArray[np.int64], axis: int) -> Array:
    """(K,) change of the distance over one voxel along an axis, by the central difference."""
    step = np.zeros(3, dtype=np.int64)
    step[axis] = 1
    high, low = distance[tuple((index + step).T)], distance[tuple((index - step).T)]
    return np.asarray((high.astype(float) - low) / 2)


def _links(hot: WallFaces, cold: WallFaces) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Pairs of faces that exchange heat: each face with the nearest of the other side, through half of its area."""
    _, to_cold = cKDTree(cold.foot_m).query(hot.foot_m)
    _, to_hot = cKDTree(hot.foot_m).query(cold.foot_m)
    first = np.concatenate([np.arange(len(hot.cell)), to_hot])
    second = np.concatenate([to_cold, np.arange(len(cold.cell))])
    return first, second, np.concatenate([hot.area_m2, cold.area_m2]) / 2


def _graph(a: NDArray[np.int64], b: NDArray[np.int64], conductance: Array, count: int) -> sparse.csr_array:
    """Conduction matrix of links between cells."""
    rows = np.concatenate([a, b, a, b])
    columns = np.concatenate([a, b, b, a])
    values = np.concatenate([conductance, conductance, -conductance, -conductance])
    return sparse.coo_array((values, (rows, columns)), shape=(count, count)).tocsr()


def _transport(stream: Stream) -> tuple[sparse.csr_array, Array]:
    """Matrix and right side of convection and conduction within one fluid, W/K and W.

    In the form Σ F (T_upwind - T_cell): a residual imbalance of the fluxes makes no heat.
    """
    mesh, fluid = stream.mesh, stream.fluid
    count, inner = len(mesh.cells), len(mesh.neighbour)
    own, other = mesh.owner[:inner], mesh.neighbour
    capacity = fluid.density_kg_m3 * fluid.specific_heat_j_kg_k
    flow = capacity * stream.flux_m3_s[:inner]
    spread = np.full(inner, fluid.conductivity_w_m_k * mesh.spacing_m)
    into_own, into_other = np.maximum(-flow, 0) + spread, np.maximum(flow, 0) + spread
    rows = np.concatenate([own, own, other, other])
    columns = np.concatenate([own, other, other, own])
    values = np.concatenate([into_own, -into_own, into_other, -into_other])
    inlet = mesh.patch("inlet")
    entering = np.bincount(
        mesh.owner[inlet], capacity * np.maximum(-stream.flux_m3_s[inlet], 0), minlength=count
    ).astype(float)
    matrix = sparse.coo_array((values, (rows, columns)), shape=(count, count)).tocsr()
    return (matrix + sparse.diags_array(entering)).tocsr(), entering * fluid.inlet_temperature_k


def _downstream(streams: tuple[Stream, ...]) -> NDArray[np.int64]:
    """The unknowns of the streams one after the other, each from high to low pressure."""
    orders, first = [], 0
    for stream in streams:
        orders.append(first + np.argsort(-stream.pressure_pa, kind="stable"))
        first += len(stream.pressure_pa)
    return np.concatenate(orders)


def _solution(stream: Stream, temperature: Array, wall_w: float) -> HeatSolution:
    mesh, fluid = stream.mesh, stream.fluid
    outlet = mesh.patch("outlet")
    # Signed: fluid that flows back in through a part of the outlet brings the temperature that it finds there.
    leaving = stream.flux_m3_s[outlet]
    mixed = float(leaving @ temperature[mesh.owner[outlet]] / leaving.sum())
    return HeatSolution(temperature, mixed, wall_w, stream.capacity_rate_w_k * (mixed - fluid.inlet_temperature_k))
