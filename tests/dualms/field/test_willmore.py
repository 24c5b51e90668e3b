import itertools

import numpy as np
import pytest

from dualms.field.descent import descend
from dualms.field.interface import distance_of, profile
from dualms.field.willmore import Willmore

N, EPS = 40, 2.0 / 40


def distance(kind: str) -> np.ndarray:
    x, y, z = (np.indices((N, N, N)) - (N - 1) / 2) / N
    return np.asarray({"plane": z, "sphere": 0.25 - np.sqrt(x**2 + y**2 + z**2)}[kind])


def problem() -> Willmore:
    mask = np.zeros((N, N, N), dtype=bool)
    mask[1:-1, 1:-1, 1:-1] = True
    return Willmore(mask, EPS, 1 / N)


def test_profile_and_distance_are_inverse() -> None:
    d = np.linspace(-0.1, 0.1, 21)
    np.testing.assert_allclose(distance_of(profile(d, EPS), EPS), d, atol=1e-6)


def test_energy_of_a_plane_is_near_zero_and_of_a_sphere_near_its_closed_form() -> None:
    willmore = problem()
    plane, _ = willmore.energy(profile(distance("plane"), EPS))
    sphere, _ = willmore.energy(profile(distance("sphere"), EPS))
    # (2√2/3) / 2 ∫ (2H)² = (√2/3) · 16π for every sphere; the grid and ε/R = 0.2 leave a few per cent.
    exact = np.sqrt(2) / 3 * 16 * np.pi
    assert plane < 0.02 * exact
    assert sphere == pytest.approx(exact, rel=0.15)


def test_gradient_is_the_derivative_of_the_energy() -> None:
    willmore = problem()
    x, y, z = (np.indices((N, N, N)) - (N - 1) / 2) / N
    u = profile(distance("sphere"), EPS)
    direction = (np.cos(7 * x) * np.cos(5 * y + 4 * z)).astype(np.float32) * willmore.mask
    _, g = willmore.energy(u)
    step = np.float32(5e-4)
    slope = (willmore.energy(u + step * direction)[0] - willmore.energy(u - step * direction)[0]) / (2 * step)
    assert float((g * direction).sum(dtype=float)) / N**3 == pytest.approx(slope, rel=0.01)


def test_descent_flattens_a_wavy_plane() -> None:
    x, y, z = (np.indices((N, N, N)) - (N - 1) / 2) / N
    u = profile(z - 0.04 * np.cos(6 * x) * np.cos(5 * y), EPS)
    willmore = problem()
    energies: list[float] = [willmore.energy(u)[0]]
    u, reason = descend(
        willmore, u, 60, lambda values: np.zeros(0, dtype=np.int64), lambda step, energy: energies.append(energy)
    )
    assert reason in ("iterations", "no step")
    assert all(b <= a for a, b in itertools.pairwise(energies))
    assert energies[-1] < 0.02 * energies[0]


def test_the_mask_must_leave_a_rim() -> None:
    with pytest.raises(ValueError, match="outermost"):
        Willmore(np.ones((4, 4, 4), dtype=bool), 0.1, 0.25)
