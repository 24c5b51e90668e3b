import numpy as np
import pytest

from dualms.field.heat import WallHeat, extend, heat_kernel


@pytest.mark.parametrize("time", [0.05, 0.5, 3.0])
def test_heat_kernel_has_the_variance_of_the_heat_equation(time: float) -> None:
    kernel = heat_kernel(time)
    offsets = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1)
    assert (kernel * offsets**2).sum() == pytest.approx(2 * time, rel=1e-3)


def test_heat_in_a_domain_keeps_constants_and_lets_nothing_through_the_wall() -> None:
    fraction = np.zeros((20, 8, 8), dtype=np.float32)
    fraction[4:16, 2:6, 2:6] = 1
    heat = WallHeat(fraction, 0.5)
    u = np.full(fraction.shape, np.float32(3))
    assert np.allclose(heat(u), 3)
    u[fraction == 0] = 1e6
    assert np.allclose(heat(u)[fraction > 0], 3)


def test_extension_keeps_known_values_and_continues_a_plane() -> None:
    x = np.broadcast_to(np.arange(40, dtype=np.float32)[:, None, None], (40, 24, 24)).copy()
    known = np.zeros(x.shape, dtype=bool)
    known[:, 8:16, 8:16] = True
    extended = extend(np.where(known, x, 99), known)
    assert np.array_equal(extended[known], x[known])
    assert np.abs(extended - x)[16:-16].max() < 1e-2
