"""Newton's method for H = 0 on surfaces whose minimal neighbour is known."""

import numpy as np

from dualms.field import topology
from dualms.field.newton import Slab, straighten

N = 32


def slab(gap: float, periodic: bool = False) -> Slab:
    index = np.indices((N, N, N))
    depth = np.minimum(index, N - 1 - index).min(axis=0) - 5.5
    depth = np.full((N, N, N), 8.0) if periodic else depth
    return Slab(depth > 0, depth.astype(np.float32), gap, periodic)


def straightened(values: np.ndarray, where: Slab, steps: int) -> tuple[np.ndarray, list[float]]:
    energies: list[float] = []
    end = straighten(values.astype(np.float32), where, steps, 1e-4, lambda step, energy, kept: energies.append(energy))
    return end, energies


def test_a_wavy_plane_becomes_minimal_within_the_domain() -> None:
    x, y, z = np.indices((N, N, N))
    where = slab(gap=N / 2)
    _, energies = straightened(z - 15.6 - np.sin(2 * np.pi * x / 20) * np.cos(2 * np.pi * y / 20), where, 8)
    # The first step has taken most already.
    assert energies[0] < 0.3
    assert energies[-1] < 0.02 * energies[0]


def test_a_catenoid_is_recovered_from_a_tube_of_its_topology() -> None:
    x, y, z = np.indices((N, N, N)) - (N - 1) / 2
    start = np.hypot(x, y) - (6.0 + 0.06 * z**2)
    where = slab(gap=10.0)
    end, energies = straightened(start, where, 12)
    assert energies[-1] < 0.02 * energies[0]
    for values in (start, end):
        assert topology.component_counts(values > 0, where.inside) == (1, 1)
    assert topology.euler_characteristic((start > 0) & where.inside) == topology.euler_characteristic(
        (end > 0) & where.inside
    )


def test_a_sphere_has_no_minimal_neighbour_and_keeps_its_topology() -> None:
    x, y, z = np.indices((N, N, N)) - (N - 1) / 2
    where = slab(gap=8.0)
    end, _ = straightened(np.sqrt(x**2 + y**2 + z**2) - 4.0, where, 8)
    assert np.isfinite(end).all()
    assert topology.component_counts(end > 0, where.inside) == (1, 1)
    assert topology.euler_characteristic((end < 0) & where.inside) == 1
