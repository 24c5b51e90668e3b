"""The examples: made by their script, and their ports lie where the specifications say."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from dualms.body.headers import headers_of
from dualms.domain import Domain
from dualms.ports import resolve_ports
from dualms.reading import read_domain_mesh
from dualms.spec import Spec, Unit

EXAMPLES = Path(__file__).parent.parent / "examples"
SPECS = sorted(EXAMPLES.glob("*.json"))


def _domain_of(spec: Path) -> Path:
    own = spec.with_suffix(".stl")
    return own if own.exists() else EXAMPLES / "u_bend.stl"


@pytest.mark.parametrize("path", SPECS, ids=lambda p: p.stem)
def test_an_example_is_valid_and_its_ports_are_on_the_boundary(path: Path) -> None:
    spec = Spec.model_validate(json.loads(path.read_text()))
    mesh = read_domain_mesh(_domain_of(path), spec.units)
    ports = resolve_ports(mesh, spec.fluids, spec.units or Unit.MM)
    assert len(ports) == 4
    assert all(port.area > 1e-4 for port in ports)


def test_the_script_makes_the_committed_domains() -> None:
    script = runpy.run_path(str(EXAMPLES / "make_examples.py"))
    for name, (corners, fillet, radius) in script["PIPES"].items():
        made = script["pipe"](script["rounded"](np.array(corners, dtype=float), fillet), radius)
        committed = read_domain_mesh(EXAMPLES / f"{name}.stl", Unit.MM)
        assert committed.volume_m3 * 1e9 == pytest.approx(made.volume, rel=1e-5)
        # Pappus: a round prism bent along a line keeps its section's area times the line's length.
        line = script["rounded"](np.array(corners, dtype=float), fillet)
        length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
        assert made.volume == pytest.approx(np.pi * radius**2 * length, rel=0.01)


def test_the_script_makes_the_committed_headers_and_they_fit() -> None:
    script = runpy.run_path(str(EXAMPLES / "make_examples.py"))
    committed = json.loads((EXAMPLES / "u_bend_headers.json").read_text())
    assert committed == script["with_headers"](json.loads((EXAMPLES / "u_bend_ports.json").read_text()))
    spec = Spec.model_validate(committed)
    mesh = read_domain_mesh(EXAMPLES / "u_bend.stl", Unit.MM)
    domain = Domain.from_mesh(mesh, resolve_ports(mesh, spec.fluids, Unit.MM))
    headers = headers_of(domain, spec.fluids, Unit.MM, spec.shell)
    assert len(headers) == 4
    grid = domain.grid(spec.surface.resolution)
    assert all(header.needed(grid, 0.0) < header.length for header in headers)
    reach = [header.flange[0] * domain.scale_m for header in headers]
    gap = np.linalg.norm(headers[0].center - headers[3].center) * domain.scale_m
    assert reach[0] + reach[3] < gap == pytest.approx(0.022, rel=1e-6)
