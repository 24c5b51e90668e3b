"""The specification of a design: what a client sends beside the domain file.

Every field has a default (but ``units`` and the ports), bounds, a unit and its source: a section of the paper, or
"ours" with the reason. Lengths are in the specification's ``units``. Unknown keys are refused.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = tuple[float, float, float]
Length = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class Unit(StrEnum):
    """Length unit of a domain file and of its specification."""

    M = "m"
    CM = "cm"
    MM = "mm"
    IN = "in"

    @property
    def metres(self) -> float:
        """Metres per unit."""
        return {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}[self.value]


class Model(BaseModel):
    """A frozen value that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


# --- ports and fluids -------------------------------------------------------------------------------------------


class DiskPort(Model):
    """The part of the boundary within ``radius`` of ``center``."""

    center: Point = Field(description="Centre of the disk, on the domain's boundary (units).")
    radius: Length = Field(description="Radius of the disk (units).")


class BoxPort(Model):
    """The part of the boundary inside an axis-parallel box."""

    box: tuple[Point, Point] = Field(description="Lower and upper corner (units).")

    @model_validator(mode="after")
    def _ordered(self) -> BoxPort:
        low, high = self.box
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise ValueError("the first corner of a port's box must not exceed the second in any coordinate")
        return self


class FacetPort(Model):
    """A whole planar facet, by its index in the domain's list of facets."""

    facet: int = Field(ge=0, description="Index in the list that `dualms inspect` and POST /v1/domains give.")


PortSpec = DiskPort | BoxPort | FacetPort


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


# --- prepare ----------------------------------------------------------------------------------------------------


class PotentialFlow(Model):
    """Guidance along the potential flow between each fluid's inlets and outlets."""

    kind: Literal["potential"] = "potential"
    spread: float = Field(
        2.0,
        ge=2,
        le=8,
        description="Exponent s of the flow that minimises ∫ |velocity|^s: 2 is the potential flow, more spreads each "
        "fluid more evenly over the envelope. Ours.",
    )


class DirectionFlow(Model):
    """Guidance along one direction."""

    kind: Literal["direction"]
    vector: Point = Field(description="Direction, of any length but zero.")

    @model_validator(mode="after")
    def _not_zero(self) -> DirectionFlow:
        if not any(self.vector):
            raise ValueError("the direction must not be the zero vector")
        return self


class PathFlow(Model):
    """Guidance along the tangent of the nearest segment of a polyline."""

    kind: Literal["path"]
    points: tuple[Point, ...] = Field(min_length=2, max_length=10_000, description="Polyline (units).")

    @model_validator(mode="after")
    def _not_a_point(self) -> PathFlow:
        if all(p == self.points[0] for p in self.points):
            raise ValueError("the points of the path must not all coincide")
        return self


class NoFlow(Model):
    """No guidance: all edges weigh 1."""

    kind: Literal["none"]


FlowSpec = Annotated[PotentialFlow | DirectionFlow | PathFlow | NoFlow, Field(discriminator="kind")]


GRAPH_PRESETS: dict[str, dict[str, object]] = {
    "aligned": {"transverse_weight": 20.0, "weighting": "smooth", "stretch": 3.0},
    "paper": {"transverse_weight": 5.0, "weighting": "two-valued", "stretch": 1.0},
}
"""What a preset sets where the specification is silent; chosen in docs/decisions/0007-alignment.md."""


class GraphSpec(Model):
    """Sites and edge weights of the graph (paper, section 4.1)."""

    preset: Literal["aligned", "paper"] = Field(
        "aligned",
        description="Defaults of the other fields: 'aligned' (ours: least solved pressure drop at equal heat transfer) "
        "or 'paper' (a = 5, two-valued, round cells).",
    )

    sites: int = Field(300, ge=8, le=20_000, description="Number of Voronoi sites. Paper, appendix A: 300 to 800.")
    transverse_weight: float = Field(
        20.0, ge=1, le=1000, description="Weight a of edges across the flow (Eq. 1). Paper: 5; 'aligned': 20."
    )
    weighting: Literal["two-valued", "smooth"] = Field(
        "smooth", description="'two-valued': a beyond 45° off the flow, else 1 (Eq. 1); 'smooth': 1 + (a-1) sin². Ours."
    )
    stretch: float = Field(
        3.0, ge=1, le=5, description="Length of a cell along the flow over its width. Paper: 1; 'aligned' (ours): 3."
    )
    port_density: float = Field(
        1.0, ge=1, le=20, description="Sites per volume at the ports over that far from them. Ours; the paper's: 1."
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        preset = given.get("preset", "aligned")
        return {**GRAPH_PRESETS.get(preset, {}), **given} if isinstance(preset, str) else given


class PartitionSpec(Model):
    """The constrained connected maximum cut (paper, section 4.2)."""

    method: Literal["anneal", "greedy"] = Field(
        "anneal", description="'greedy' is the paper's Algorithm 1; 'anneal' (ours) searches further, same constraints."
    )
    seconds: float = Field(1.0, gt=0, le=600, description="Search budget of 'anneal', as work worth so many seconds.")
    slack: float = Field(
        0.01,
        ge=0,
        le=0.2,
        description="Share of the cut weight that 'anneal' may give up for channels that resist the flow less. Ours.",
    )
    hot_share: float | None = Field(
        None, ge=0.15, le=0.85, description="Share of the sites that the hot fluid gets, within 0.02; null: free. Ours."
    )


# --- solve ------------------------------------------------------------------------------------------------------


class AutoField(Model):
    """A neural method where a GPU worker is registered, the phase field otherwise; resolved at submission."""

    method: Literal["auto"] = "auto"


class PhaseField(Model):
    """A diffuse-interface flow from the equidistant surface (ours; ends in seconds on a CPU)."""

    method: Literal["phase-field"]
    resolution: int = Field(
        128, ge=24, le=512, description="Voxels along the longest side; raised where sites are too dense. Ours."
    )
    minimality: float = Field(
        0.5, ge=0, le=1, description="0: equidistant surface; 0.5: diffused; 1: minimal surface (H → 0). Ours."
    )


NEURAL_PRESETS: dict[str, dict[str, object]] = {
    "paper": {},
    "released": {"hidden_layers": 4},
    "cpu": {
        "steps": 500,
        "points": 2048,
        "learning_rate": 2e-3,
        "decay_every": 25,
        "gradient": "secants",
        "connect": True,
    },
}
"""What a preset sets where the specification is silent; everything else has the paper's value."""


class NetworkField(Model):
    """A network, and how it is trained with the paper's losses (section 5)."""

    steps: int = Field(51_200, ge=1, le=1_000_000, description="Training steps. Paper, section 6.1: 5.12e4.")
    points: int = Field(
        32_768,
        ge=64,
        le=1_048_576,
        description="Skeleton and domain points per step, each. Paper, section 6.1: 32,768.",
    )
    features: int = Field(2048, ge=16, le=8192, description="Fourier features (sine and cosine). Paper, section 5.1.")
    fourier_scale: float = Field(2.0, gt=0, le=100, description="Std of the frequencies (1/unit). Released code: 2.")
    hidden_layers: int = Field(3, ge=1, le=8, description="Hidden layers. Paper: 3 (released code: 4).")
    width: int = Field(256, ge=8, le=2048, description="Neurons a hidden layer. Paper, section 5.1: 256.")
    skeleton_weight: float = Field(5000.0, ge=0, description="λ1 of Eq. 6. Paper: 5000.")
    smoothness_weight: float = Field(1.0, ge=0, description="λ2 of Eq. 6. Paper: 1.")
    noise_std: float = Field(0.002, ge=0, le=1, description="σ of the samples' noise, unit-cube units. Paper: 0.002.")
    learning_rate: float = Field(3e-5, gt=0, le=1, description="Adam's first step size. Paper: 3e-5.")
    decay: float = Field(0.9, gt=0, le=1, description="Factor on the learning rate. Released code: 0.9.")
    decay_every: int = Field(5000, ge=1, description="Steps between two decays. Released code: 5,000.")
    gradient: Literal["exact", "secants"] = Field(
        "exact",
        description="Total variation by second derivatives, or by secants along random lines (ours, cheaper).",
    )
    connect: bool = Field(
        False, description="Late in training, teach stray pockets their surrounding fluid (ours; the paper has none)."
    )


class NeuralField(NetworkField):
    """The paper's network and losses (section 5)."""

    method: Literal["neural"]
    preset: Literal["paper", "released", "cpu"] = Field(
        "paper",
        description="Defaults of the other fields: 'paper'; 'released', the authors' code where it differs (4 hidden "
        "layers); 'cpu' (ours), a budget that ends in minutes on two cores.",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        preset = given.get("preset", "paper")
        return {**NEURAL_PRESETS.get(preset, {}), **given} if isinstance(preset, str) else given


class DistilledField(NetworkField):
    """The phase field taught to the paper's network, then trained on with the paper's losses (ours)."""

    method: Literal["distilled"]
    resolution: int = Field(128, ge=24, le=512, description="Voxels of the phase field along the longest side. Ours.")
    minimality: float = Field(0.5, ge=0, le=1, description="Of the phase field that is taught. Ours.")
    teaching_steps: int = Field(1200, ge=0, le=1_000_000, description="Steps on the phase field's values. Ours.")
    steps: int = Field(100, ge=0, le=1_000_000, description="Steps with the paper's losses after that. Ours.")
    points: int = Field(4096, ge=64, le=1_048_576, description="Points per step. Ours.")
    learning_rate: float = Field(3e-3, gt=0, le=1, description="Adam's first step size. Ours.")
    decay: float = Field(0.9, gt=0, le=1, description="Factor on the learning rate. Ours.")
    decay_every: int = Field(40, ge=1, description="Steps between two decays. Ours.")
    gradient: Literal["exact", "secants"] = Field("secants", description="Of the total variation. Ours: cheaper.")


FieldSpec = Annotated[AutoField | PhaseField | NeuralField | DistilledField, Field(discriminator="method")]


# --- build ------------------------------------------------------------------------------------------------------


class SurfaceSpec(Model):
    """Extraction of the zero level set."""

    resolution: int = Field(256, ge=24, le=512, description="Voxels along the longest side. Paper, section 6.1: 256.")


class WallThickness(Model):
    """Wall given by its thickness."""

    thickness: Length = Field(0.5, description="Thickness of the separating wall (units). Ours: printable in metal.")


class WallFraction(Model):
    """Wall given by the share of the domain that it takes."""

    volume_fraction: float = Field(gt=0, lt=0.9, description="Wall volume over domain volume, shell left out.")


class ShellSpec(Model):
    """A closed skin of the solid along the inside of the envelope, open at the ports."""

    thickness: Length = Field(1.0, description="Thickness (units). Ours: twice the default wall.")


class RequireSpec(Model):
    """Requirements on the report's figures; each becomes a line of the certificate. SI units."""

    min_channel_m: float | None = Field(None, gt=0, description="Least channel width of either fluid.")
    min_passage_m: float | None = Field(None, gt=0, description="Largest ball that gets through either fluid.")
    min_wall_m: float | None = Field(None, gt=0, description="Measured wall thickness, 1st percentile.")
    max_dead_end_fraction: float | None = Field(None, ge=0, le=1, description="Stagnant share of either fluid.")
    max_overhang_fraction: float | None = Field(None, ge=0, le=1, description="Surface that faces down below 45°.")
    max_solid_fraction: float | None = Field(None, gt=0, le=1, description="Solid over the envelope's volume.")
    min_area_density_per_m: float | None = Field(None, gt=0, description="Surface over the envelope's volume.")


# --- evaluate ---------------------------------------------------------------------------------------------------


class EvaluationSpec(Model):
    """Solved pressure drop and heat transfer, and baselines in the same envelope."""

    solver: Literal["openfoam"] = "openfoam"
    resolution: int = Field(96, ge=24, le=256, description="Voxels along the longest side. Ours: trends hold at 64.")
    baselines: tuple[Literal["gyroid", "p", "d", "iwp"], ...] = Field((), description="Surfaces to compare with.")
    match: Literal["solid-fraction", "ua"] = Field(
        "solid-fraction", description="What the baseline's cell size is chosen to equal."
    )
    iterations: int = Field(
        400, ge=20, le=10_000, description="Limit of the flow's iterations; it stops as soon as ΔP has settled. Ours."
    )
    scheme: Literal["linear-upwind", "upwind"] = Field(
        "linear-upwind", description="Momentum convection: second order, or first order (steadier, 20 % low). Ours."
    )
    wall_conductivity_w_m_k: float = Field(
        237.0, gt=0, le=1e5, description="Thermal conductivity of the wall (W/(m·K)). Paper, appendix C, aluminium."
    )
    keep_case: bool = Field(False, description="Keep the solver's case as an artifact.")


# --- the whole --------------------------------------------------------------------------------------------------


class Spec(Model):
    """Everything that a design depends on besides the domain file."""

    units: Unit | None = Field(
        None, description="Length unit; required where the file carries none (all but GLB, 3MF)."
    )
    fluids: FluidsSpec
    flow: FlowSpec = Field(default_factory=PotentialFlow)
    graph: GraphSpec = Field(default=GraphSpec())
    partition: PartitionSpec = Field(default=PartitionSpec())
    field: FieldSpec = Field(default_factory=AutoField)
    surface: SurfaceSpec = Field(default=SurfaceSpec())
    wall: WallThickness | WallFraction = Field(default=WallThickness())
    shell: ShellSpec | None = Field(default=ShellSpec())
    build_direction: Point = Field((0.0, 0.0, 1.0), description="Up in the printer.")
    require: RequireSpec = Field(default=RequireSpec(), description="What the certificate must also meet.")
    evaluation: EvaluationSpec | None = Field(None, description="Solve the flow too (needs a cfd worker).")
    seed: int = Field(0, ge=0, lt=2**32, description="Seed of everything random.")

    @model_validator(mode="after")
    def _up_is_a_direction(self) -> Spec:
        if not any(self.build_direction):
            raise ValueError("build_direction must not be the zero vector")
        return self
