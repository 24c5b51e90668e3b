import numpy as np
import pytest

from dualms.skeleton_mesh import SIDES, bars


def test_bars_are_closed_prisms_of_the_right_volume() -> None:
    rng = np.random.default_rng(0)
    starts, ends = rng.random((2, 20, 3))
    mesh = bars(starts, ends, 0.01)
    length = np.linalg.norm(ends - starts, axis=1).sum()
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(length * SIDES / 2 * np.sin(2 * np.pi / SIDES) * 0.01**2)


def test_a_segment_without_length_makes_no_bar() -> None:
    point = np.array([[0.2, 0.3, 0.4]])
    assert len(bars(point, point, 0.01).faces) == 0
