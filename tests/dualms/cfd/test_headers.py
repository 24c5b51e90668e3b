"""Headers in the solved flow: the pressure drop of their pipes is added, and heat passes only in the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dualms.body.headers import headers_of
from dualms.cfd.evaluate import evaluate
from dualms.cfd.openfoam import OpenFoam
from dualms.progress import Silent
from dualms.spec import EvaluationSpec, FluidsSpec, ShellSpec, Unit
from tests.dualms.shapes import box_mesh, domain_of, end_ports, halves, with_headers

SIZE = (80.0, 60.0, 40.0)
RADIUS, LENGTH = 6.0, 30.0
VISCOSITY, DENSITY, FLOW = 0.05, 1000.0, 2e-3


@pytest.mark.cfd
def test_pipes_add_their_poiseuille_drop(foam: OpenFoam, tmp_path: Path) -> None:
    slow = {"density_kg_m3": DENSITY, "viscosity_pa_s": VISCOSITY, "mass_flow_kg_s": FLOW}
    document = end_ports(SIZE, RADIUS).model_dump()
    for fluid in document.values():
        fluid.update(slow)
    bare = FluidsSpec.model_validate(document)
    piped = with_headers(bare, {"radius": RADIUS, "length": LENGTH, "wall": 1.5})
    domain = domain_of(box_mesh(SIZE), bare)
    grid = domain.grid(48, 4)
    spec = EvaluationSpec(resolution=48, iterations=150)
    shell = ShellSpec(thickness=2.5)
    drops = []
    for fluids in (bare, piped):
        headers = headers_of(domain, fluids, Unit.MM, shell)
        found = evaluate(domain, halves(grid), grid, 0.02, fluids, spec, Silent(), tmp_path, 2.5 / 80, headers=headers)
        assert found.problem is None
        assert found.design is not None
        assert abs(found.design.hot.mass_imbalance) < 1e-3
        drops.append(found.design.hot.pressure_drop_pa)
    pipe = 8 * VISCOSITY * (LENGTH / 1e3) * (FLOW / DENSITY) / (np.pi * (RADIUS / 1e3) ** 4)
    # Seven voxels across a pipe: its stair-stepped section is a little off, and the flow enters undeveloped.
    assert drops[1] - drops[0] == pytest.approx(2 * pipe, rel=0.25)
