"""The unit cube with opposite faces joined: the domain of periodic surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualms.grid import Grid


@dataclass(frozen=True)
class Torus:
    """A domain without a wall, where P, G, D and I-WP live; their truths need no boundary condition."""

    volume: float = 1.0

    def grid(self, resolution: int) -> Grid:
        """Voxels of edge 1/resolution, each point of the torus in one."""
        return Grid(np.full(3, 0.5 / resolution), 1 / resolution, (resolution,) * 3)
