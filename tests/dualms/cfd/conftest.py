"""Straight ducts and a small freeform exchanger, with fluids slow enough for closed forms."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import trimesh

from dualms.cfd.baselines import tpms_exchanger
from dualms.cfd.channels import Openings, VoxelExchanger
from dualms.cfd.openfoam import OpenFoam, find_openfoam
from dualms.domain import Domain
from dualms.ports import resolve_ports
from dualms.reading import read_domain_mesh
from dualms.spec import FluidSpec, FluidsSpec, Unit

SIDE_M = 0.01
BOX = (0.12, 0.06, 0.06)


def two_ducts(height: int, width: int, length: int, side_walls: bool) -> VoxelExchanger:
    """Two equal ducts along x, ``width`` x ``height`` cells, hot below cold, a wall of one voxel round each of them.

    ``height`` cells measure ``SIDE_M``. Without side walls the sides belong to the envelope.
    """
    pad_y = 2 if side_walls else 1
    shape = (length + 2, width + 2 * pad_y, 2 * height + 5)
    labels = np.zeros(shape, dtype=np.int8)
    body = (slice(1, -1), slice(1, -1), slice(1, -1))
    labels[body] = 2
    y = slice(pad_y, pad_y + width)
    labels[1:-1, y, 2 : 2 + height] = 1
    labels[1:-1, y, 3 + height : 3 + 2 * height] = -1
    spacing = SIDE_M / height
    _, across, up = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")

    def depth(first: int) -> np.ndarray:
        """Distance to the nearest wall of the duct whose lowest cell is ``first``, positive inside, in voxels."""
        inside = np.minimum(up - first + 0.5, first + height - 0.5 - up)
        if side_walls:
            inside = np.minimum(inside, np.minimum(across - pad_y + 0.5, pad_y + width - 0.5 - across))
        return inside

    distance = np.where(up <= 2 + height, depth(2) + 0.5, -depth(3 + height) - 0.5) * spacing

    def openings(fluid: int) -> Openings:
        found = {}
        for x, direction in ((1, 0), (length, 1)):
            cells = np.argwhere(labels[x] == fluid)
            found[direction] = np.column_stack([np.full(len(cells), x), cells, np.full(len(cells), direction)])
        inlet, normal = (found[0], [-1.0, 0, 0]) if fluid == 1 else (found[1], [1.0, 0, 0])
        return Openings(inlet, found[1] if fluid == 1 else found[0], np.tile(normal, (len(inlet), 1)))

    return VoxelExchanger(
        labels, distance.astype(np.float32), spacing, np.zeros(3), spacing, openings(1), openings(-1), 0.0, 0.0
    )


def slow_fluid(reynolds: float, peclet: float, area_m2: float, **other: float) -> FluidSpec:
    """A fluid of given Reynolds and Péclet numbers with respect to ``SIDE_M``, through an area."""
    speed = 0.01
    return FluidSpec.model_validate(
        {
            "inlets": [{"facet": 0}],
            "outlets": [{"facet": 1}],
            "density_kg_m3": 1000.0,
            "viscosity_pa_s": 1000.0 * speed * SIDE_M / reynolds,
            "specific_heat_j_kg_k": 1000.0,
            "conductivity_w_m_k": 1000.0 * 1000.0 * speed * SIDE_M / peclet,
            "mass_flow_kg_s": 1000.0 * speed * area_m2,
            **other,
        }
    )


@lru_cache
def box_design(size: tuple[float, float, float], shared: bool) -> tuple[Domain, FluidsSpec]:
    """A box with openings on its two ends along x: both over the whole end, or hot above and cold below."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "box.stl"
        trimesh.creation.box(bounds=[[0, 0, 0], size]).export(path)
        mesh = read_domain_mesh(path, Unit.M)
    x, y, z = size

    def port(at: float, low: float, high: float) -> dict[str, object]:
        return {"box": [[at, 0.0, low], [at, y, high]]}

    upper, lower = ((0.0, z), (0.0, z)) if shared else ((0.6 * z, z), (0.0, 0.4 * z))
    slow = {"mass_flow_kg_s": 2e-3}
    fluids = FluidsSpec.model_validate(
        {
            "hot": {"inlets": [port(0.0, *upper)], "outlets": [port(x, *upper)], **slow},
            "cold": {"inlets": [port(x, *lower)], "outlets": [port(0.0, *lower)], **slow},
        }
    )
    return Domain.from_mesh(mesh, resolve_ports(mesh, fluids, Unit.M)), fluids


@lru_cache
def gyroid_in_box(wall: float) -> VoxelExchanger:
    """A gyroid of cell 0.25 in the box with shared openings, at 40 voxels."""
    domain, _ = box_design(BOX, True)
    return tpms_exchanger(domain, "gyroid", 0.25, domain.grid(40, 2), wall)


@pytest.fixture(scope="session")
def foam() -> OpenFoam:
    found = find_openfoam()
    if found is None:
        pytest.skip("OpenFOAM is not installed")
    return found
