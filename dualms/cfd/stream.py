"""One fluid's solved flow, made ready for its heat balance: conserved fluxes, and the thermal layer on its wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualms.cfd.channels import VoxelExchanger
from dualms.cfd.film import film_thickness
from dualms.cfd.fluxes import conservative
from dualms.cfd.mesh import ChannelMesh
from dualms.cfd.shear import wall_shear
from dualms.cfd.wall import WallSheet, wall_sheet
from dualms.grid import Array
from dualms.spec import FluidSpec

STEPPED = 2 / 3  # true area of a stair-stepped surface over its steps' area, mean over all directions


@dataclass(frozen=True)
class Stream:
    """One fluid's mesh, flow, wall and properties.

    Parameters
    ----------
    mesh
        Its cells and faces.
    flux_m3_s
        (F,) volume flow through the faces along their normals; leaves no cell with a net outflow.
    velocity_m_s
        (N, 3) of the cells.
    pressure_pa
        (N,) of the cells: it falls along the flow, which the solver's numbering follows.
    wall
        The fluid's side of the separating wall, (W,) triangles.
    film_m
        (W,) thickness of the layer that resists between each triangle and the mixed fluid.
    fluid
        Its properties.
    """

    mesh: ChannelMesh
    flux_m3_s: Array
    velocity_m_s: Array
    pressure_pa: Array
    wall: WallSheet
    film_m: Array
    fluid: FluidSpec

    def __post_init__(self) -> None:
        if self.flux_m3_s.shape != self.mesh.owner.shape or not np.isfinite(self.flux_m3_s).all():
            raise ValueError("a stream needs one finite flux per face")
        if self.film_m.shape != self.wall.cell.shape or not (self.film_m > 0).all():
            raise ValueError("a stream needs one positive film thickness per triangle of its wall")

    @property
    def capacity_rate_w_k(self) -> float:
        """Mass flow times specific heat."""
        return self.fluid.mass_flow_kg_s * self.fluid.specific_heat_j_kg_k

    @property
    def hydraulic_diameter_m(self) -> float:
        """Four times the volume over the wetted surface, wall and envelope."""
        envelope = self.mesh.patch("envelope")
        steps = float(envelope.stop - envelope.start) * self.mesh.face_area_m2
        wetted = float(self.wall.area_m2.sum()) + STEPPED * steps
        return 4 * len(self.mesh.cells) * self.mesh.spacing_m**3 / wetted


def stream_of(
    exchanger: VoxelExchanger,
    sign: int,
    mesh: ChannelMesh,
    flux_m3_s: Array,
    velocity_m_s: Array,
    pressure_pa: Array,
    fluid: FluidSpec,
) -> Stream:
    """A solved flow of fluid 1 or -1 with its fluxes made conservative and its thermal layer computed."""
    wall = wall_sheet(exchanger, mesh, sign)
    shear = wall_shear(exchanger, mesh, velocity_m_s, wall.mesh)
    diffusivity = fluid.conductivity_w_m_k / (fluid.density_kg_m3 * fluid.specific_heat_j_kg_k)
    film = film_thickness(exchanger, mesh, wall, shear, pressure_pa, diffusivity)
    return Stream(mesh, conservative(mesh, flux_m3_s), velocity_m_s, pressure_pa, wall, film, fluid)
