"""Values survive a file unchanged, and the same value gives the same bytes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from dualms.domain import Domain
from dualms.values import load, save
from tests.dualms.shapes import box_mesh, domain_of, end_ports


def test_a_domain_with_ports_survives_a_file(tmp_path: Path) -> None:
    domain = domain_of(box_mesh(), end_ports())
    save(domain, tmp_path / "domain.safetensors")
    again = load(Domain, tmp_path / "domain.safetensors")
    np.testing.assert_array_equal(again.vertices, domain.vertices)
    assert [p.name for p in again.ports] == [p.name for p in domain.ports]
    np.testing.assert_array_equal(again.ports[2].samples, domain.ports[2].samples)
    assert again.ports[3].inlet is False


def test_the_same_value_gives_the_same_bytes(tmp_path: Path) -> None:
    domain = domain_of(box_mesh(), end_ports())
    contents = set()
    for k in range(4):
        save(domain, tmp_path / f"{k}.safetensors")
        contents.add((tmp_path / f"{k}.safetensors").read_bytes())
    assert len(contents) == 1


def test_a_file_of_another_type_is_refused(tmp_path: Path) -> None:
    @dataclass(frozen=True)
    class Other:
        number: float

    save(Other(1.5), tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="holds a Other, not a Domain"):
        load(Domain, tmp_path / "other.safetensors")
