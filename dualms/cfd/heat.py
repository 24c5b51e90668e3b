"""Heat transfer on the frozen flow: one linear system for both fluids, coupled through the separating wall.

First-order upwind convection on the voxels of a fluid that is mixed across its channel, and between it and the wall the
film of the thermal layer (:mod:`dualms.cfd.film`), whose coefficient is defined against the mixed temperature. Voxels
resolve neither the layers nor the core: in channels across the lattice upwinding mixes it, along the lattice nothing
does; so the core is mixed on purpose, by a diffusivity in proportion to speed and width. Each triangle of one side of
the wall exchanges heat with the nearest on the other side, through half of each one's area, so that what leaves one
fluid enters the other. The wall is a resistance across its thickness; conduction along it is left out, and so is
conduction through inlets and outlets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from dualms.cfd.channels import VoxelExchanger
from dualms.cfd.linear import solve_upwind
from dualms.cfd.stream import Stream
from dualms.grid import Array

MIXING = 0.1  # diffusivity of the core over speed times hydraulic diameter: mixed within some ten diameters
ACROSS = 2.0  # voxels, beyond the wall's thickness, at most between two triangles that exchange heat


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
    link_hot, link_cold, area = _links(exchanger, hot, cold)
    resistance = (
        hot.film_m[link_hot] / hot.fluid.conductivity_w_m_k
        + cold.film_m[link_cold] / cold.fluid.conductivity_w_m_k
        + exchanger.wall_m / wall_conductivity_w_m_k
    )
    conductance = area / resistance
    count = len(hot.mesh.cells)
    a, b = hot.wall.cell[link_hot], cold.wall.cell[link_cold] + count
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


def isothermal(stream: Stream, wall_k: float) -> HeatSolution:
    """Solve one fluid's temperatures with all of its wall at one temperature."""
    conductance = stream.wall.area_m2 * stream.fluid.conductivity_w_m_k / stream.film_m
    matrix, rhs = _transport(stream)
    diagonal = np.bincount(stream.wall.cell, conductance, minlength=len(stream.mesh.cells))
    matrix = (matrix + sparse.diags_array(diagonal)).tocsr()
    temperature = solve_upwind(matrix, rhs + diagonal * wall_k, _downstream((stream,)))
    return _solution(stream, temperature, float(diagonal @ (wall_k - temperature)))


def _links(exchanger: VoxelExchanger, hot: Stream, cold: Stream) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Pairs of triangles that exchange heat: each with the nearest of the other side, through half of its area."""
    limit = exchanger.wall_m + ACROSS * exchanger.spacing_m
    ours, theirs = hot.wall.mesh.centroids, cold.wall.mesh.centroids
    away_cold, to_cold = cKDTree(theirs).query(ours, distance_upper_bound=limit)
    away_hot, to_hot = cKDTree(ours).query(theirs, distance_upper_bound=limit)
    from_hot, from_cold = np.flatnonzero(np.isfinite(away_cold)), np.flatnonzero(np.isfinite(away_hot))
    first = np.concatenate([from_hot, to_hot[from_cold]])
    second = np.concatenate([to_cold[from_hot], from_cold])
    area = np.concatenate([hot.wall.area_m2[from_hot], cold.wall.area_m2[from_cold]]) / 2
    return first, second, area


def _graph(a: NDArray[np.int64], b: NDArray[np.int64], conductance: Array, count: int) -> sparse.csr_array:
    """Conduction matrix of links between cells."""
    rows = np.concatenate([a, b, a, b])
    columns = np.concatenate([a, b, b, a])
    values = np.concatenate([conductance, conductance, -conductance, -conductance])
    return sparse.coo_array((values, (rows, columns)), shape=(count, count)).tocsr()


def _transport(stream: Stream) -> tuple[sparse.csr_array, Array]:
    """Matrix and right side of convection, conduction and mixing within one fluid, W/K and W.

    In the form Σ F (T_upwind - T_cell): a residual imbalance of the fluxes makes no heat.
    """
    mesh, fluid = stream.mesh, stream.fluid
    count, inner = len(mesh.cells), len(mesh.neighbour)
    own, other = mesh.owner[:inner], mesh.neighbour
    capacity = fluid.density_kg_m3 * fluid.specific_heat_j_kg_k
    flow = capacity * stream.flux_m3_s[:inner]
    speed = np.linalg.norm(stream.velocity_m_s, axis=1)
    mixing = MIXING * stream.hydraulic_diameter_m * (speed[own] + speed[other]) / 2
    spread = (fluid.conductivity_w_m_k + capacity * mixing) * mesh.spacing_m
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
