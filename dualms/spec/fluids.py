"""The two fluids: their ports and their properties."""

from __future__ import annotations

from pydantic import Field, model_validator

from dualms.spec.model import Model
from dualms.spec.ports import PortSpec


class FluidSpec(Model):
    """One fluid: where it enters and leaves, and its properties at the reference temperature."""

    inlets: tuple[PortSpec, ...] = Field(min_length=1, max_length=16, description="Where the fluid enters.")
    outlets: tuple[PortSpec, ...] = Field(min_length=1, max_length=16, description="Where the fluid leaves.")
    density_kg_m3: float = Field(915.74, gt=0, description="Density (kg/m³). Paper, appendix C, lubricating oil.")
    viscosity_pa_s: float = Field(2.51e-3, gt=0, description="Dynamic viscosity (Pa·s). Paper, appendix C.")
    specific_heat_j_kg_k: float = Field(2102.22, gt=0, description="Specific heat (J/(kg·K)). Paper, appendix C.")
    conductivity_w_m_k: float = Field(0.14, gt=0, description="Thermal conductivity (W/(m·K)). Paper, appendix C.")
    inlet_temperature_k: float = Field(403.15, gt=0, description="Inlet temperature (K). Paper, appendix C.")
    mass_flow_kg_s: float = Field(0.13, gt=0, description="Mass flow through all inlets together (kg/s). Paper.")


class ColdFluidSpec(FluidSpec):
    """The cold fluid; its defaults are the paper's fuel."""

    density_kg_m3: float = Field(801.60, gt=0, description="Density (kg/m³). Paper, appendix C, fuel.")
    viscosity_pa_s: float = Field(1.58e-3, gt=0, description="Dynamic viscosity (Pa·s). Paper, appendix C.")
    specific_heat_j_kg_k: float = Field(2073.29, gt=0, description="Specific heat (J/(kg·K)). Paper, appendix C.")
    conductivity_w_m_k: float = Field(0.13, gt=0, description="Thermal conductivity (W/(m·K)). Paper, appendix C.")
    inlet_temperature_k: float = Field(313.15, gt=0, description="Inlet temperature (K). Paper, appendix C.")


class FluidsSpec(Model):
    """The two fluids; the field is positive in ``hot`` and negative in ``cold``."""

    hot: FluidSpec
    cold: ColdFluidSpec

    @model_validator(mode="after")
    def _no_header_on_a_shared_opening(self) -> FluidsSpec:
        hot, cold = ((*fluid.inlets, *fluid.outlets) for fluid in (self.hot, self.cold))
        for ours in hot:
            for theirs in cold:
                if ours.place == theirs.place and (ours.header or theirs.header):
                    raise ValueError(
                        "a header cannot stand on an opening that both fluids share: give each fluid a port of its own"
                    )
        return self
