"""Geometry of level sets from samples, against spheres and flat tori."""

import numpy as np
import pytest

from dualms.field.sheet import Jet, Sheet


def ball(n: int) -> np.ndarray:
    x, y, z = (np.indices((n, n, n)) - (n - 1) / 2) / n
    return (n * (np.sqrt(x**2 + y**2 + z**2) - 0.35)).astype(np.float32)


def whole(n: int) -> np.ndarray:
    return np.ones((n, n, n), dtype=bool)


def test_curvature_of_a_sphere_converges_in_second_order() -> None:
    errors = []
    for n in (24, 48):
        values = ball(n)
        sheet = Sheet.of(values, Jet.of(values), whole(n), periodic=False)
        # Lengths are in voxels, so curvatures come out over n.
        errors.append(np.abs(sheet.bend * n - 2 / 0.35).max())
        assert np.abs(sheet.square * n**2 - 2 / 0.35**2).max() < 0.15 * 2 / 0.35**2
    assert errors[1] < 0.05
    assert np.log2(errors[0] / errors[1]) > 1.7


def test_elements_integrate_area_and_the_dirichlet_energy_of_a_sphere() -> None:
    n = 48
    values = ball(n)
    sheet = Sheet.of(values, Jet.of(values), whole(n), periodic=False)
    assert sheet.mass.sum() / n**2 == pytest.approx(4 * np.pi * 0.35**2, rel=0.01)
    # z is an eigenfunction with eigenvalue 2 / R², and its mean square is R² / 3.
    z = sheet.points[:, 2] - (n - 1) / 2
    assert z @ (sheet.stiffness @ z) / n**2 == pytest.approx(2 / 3 * 4 * np.pi * 0.35**2, rel=0.01)
    np.testing.assert_allclose(sheet.stiffness @ np.ones(len(z)), 0, atol=1e-9)


def test_a_plane_across_the_torus_is_closed() -> None:
    n = 16
    z = np.indices((n, n, n))[2]
    values = (z - 7.3).astype(np.float32)
    values[:, :, 12:] = (14.6 - z[:, :, 12:]).astype(np.float32)
    sheet = Sheet.of(values, Jet.of(values), whole(n), periodic=True)
    low = sheet.points[:, 2] < 9
    assert sheet.mass[low].sum() == pytest.approx(n * n)
    # Constant and wave along x: eigenvalues 0 and (2π/n)² of a flat torus, which a rim would change.
    wave = np.where(low, np.sin(2 * np.pi * sheet.points[:, 0] / n), 0)
    assert wave @ (sheet.stiffness @ wave) == pytest.approx((2 * np.pi / n) ** 2 * n * n / 2, rel=0.03)
