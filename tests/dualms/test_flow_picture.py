"""The guidance's picture: lines stay inside and follow the field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from dualms.flow import flow_field
from dualms.flow_picture import flow_picture, trace
from dualms.spec import DirectionFlow, PotentialFlow
from tests.dualms.shapes import box_mesh, domain_of, end_ports, shared_ends


def test_traced_lines_follow_a_direction_to_both_walls() -> None:
    domain = domain_of(box_mesh(), end_ports())
    flow = flow_field(domain, DirectionFlow(kind="direction", vector=(1, 0, 0)), 1e-3)
    assert flow is not None
    (line,) = trace(flow, np.array([[0.4, 0.3, 0.2]]))
    np.testing.assert_allclose(line[:, 1:], np.broadcast_to([0.3, 0.2], (len(line), 2)), atol=1e-6)
    assert np.ptp(line[:, 0]) > 0.95
    assert (np.diff(line[:, 0]) > 0).all() or (np.diff(line[:, 0]) < 0).all()


def test_picture_is_written_and_repeats(tmp_path: Path) -> None:
    domain = domain_of(box_mesh(), shared_ends())
    flow = flow_field(domain, PotentialFlow(), 1e-3)
    assert flow is not None
    for name in ("a.png", "b.png"):
        flow_picture(domain, flow, tmp_path / name)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size[0] > 1000
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
