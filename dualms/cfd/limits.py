"""The floor under any design: the same volume and wetted surface as straight round tubes from inlet to outlet."""

from __future__ import annotations

import numpy as np
from skimage.graph import MCP_Geometric

from dualms.cfd.channels import OUTSIDE, VoxelExchanger
from dualms.cfd.results import StraightPassage
from dualms.spec import FluidSpec


def straight_passage(
    exchanger: VoxelExchanger, sign: int, volume_m3: float, hydraulic_diameter_m: float, fluid: FluidSpec
) -> StraightPassage:
    """Poiseuille and Graetz for round tubes with a fluid's volume and hydraulic diameter.

    Parameters
    ----------
    exchanger, sign
        Envelope, and the fluid whose ports are joined.
    volume_m3, hydraulic_diameter_m
        Of the fluid.
    fluid
        Properties and mass flow.

    Notes
    -----
    ΔP = 32 μ Q L² / (V D²) with the shortest length L within the envelope and the cross-section V/L. Mean Nusselt
    number of a developing temperature in developed flow by Hausen 1943: 3.66 + 0.0668 Gz / (1 + 0.04 Gz^(2/3)).
    """
    length = shortest_length(exchanger, sign)
    flow = fluid.mass_flow_kg_s / fluid.density_kg_m3
    drop = 32 * fluid.viscosity_pa_s * flow * length**2 / (volume_m3 * hydraulic_diameter_m**2)
    speed = flow * length / volume_m3
    peclet = fluid.density_kg_m3 * fluid.specific_heat_j_kg_k * speed * hydraulic_diameter_m / fluid.conductivity_w_m_k
    graetz = peclet * hydraulic_diameter_m / length
    nusselt = 3.66 + 0.0668 * graetz / (1 + 0.04 * graetz ** (2 / 3))
    area = 4 * volume_m3 / hydraulic_diameter_m
    return StraightPassage(
        length_m=length,
        hydraulic_diameter_m=hydraulic_diameter_m,
        pressure_drop_pa=drop,
        film_conductance_w_k=nusselt * fluid.conductivity_w_m_k / hydraulic_diameter_m * area,
    )


def shortest_length(exchanger: VoxelExchanger, sign: int) -> float:
    """Mean over the outlet of the shortest way (m) within the envelope from the fluid's inlet."""
    openings = exchanger.openings(sign)
    cost = np.where(exchanger.labels != OUTSIDE, 1.0, -1.0)
    ways, _ = MCP_Geometric(cost).find_costs(openings.inlet[:, :3])
    found = ways[tuple(openings.outlet[:, :3].T)]
    # From voxel centre to voxel centre: half a voxel is missing at each end.
    return float(found[np.isfinite(found)].mean() + 1) * exchanger.spacing_m
