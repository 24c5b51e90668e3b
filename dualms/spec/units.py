"""Length units."""

from __future__ import annotations

from enum import StrEnum


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
