"""What every part of the specification is made of: a frozen model, lengths and points, kinds told apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Discriminator, Field

Vector = tuple[float, float, float]
Length = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class Model(BaseModel):
    """A frozen value that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def by_key(kinds: Mapping[str, str], default: str | None = None) -> Discriminator:
    """Tell the kinds of an object apart by a key that one of them alone has: faults are then those of the kind meant.

    Parameters
    ----------
    kinds
        Key to the tag of the kind that has it.
    default
        Tag of the kind that an object without any of the keys is.
    """
    *most, last = (f"'{key}'" for key in kinds)

    def tag(given: object) -> str | None:
        if not isinstance(given, Mapping | BaseModel):
            return None
        keys = given if isinstance(given, Mapping) else type(given).model_fields
        return next((kind for key, kind in kinds.items() if key in keys), default)

    needed = f"one of the keys {', '.join(most)} or {last} is needed"
    return Discriminator(tag, custom_error_type="unknown_kind", custom_error_message=needed)
