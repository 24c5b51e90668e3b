"""The field's method and its parameters."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualms.spec.model import Model


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
