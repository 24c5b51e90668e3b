import numpy as np

from dualms.field.samples import GridSamples
from dualms.grid import Grid


def test_resampling_reproduces_cubic_polynomials() -> None:
    def cubic(grid: Grid) -> np.ndarray:
        x, y, z = grid.points().T
        return (x**3 - 2 * x * y**2 + z**2 * y - 0.3).reshape(grid.shape)

    coarse = Grid(np.array([-0.2, -0.1, 0.0]), 0.1, (14, 13, 12))
    fine = Grid(np.array([0.01, 0.02, 0.03]), 0.037, (20, 21, 22))
    values = GridSamples(coarse, cubic(coarse).astype(np.float32)).on(fine)
    assert np.abs(values - cubic(fine)).max() < 2e-6


def test_resampling_is_constant_beyond_the_samples() -> None:
    grid = Grid(np.zeros(3), 0.1, (5, 5, 5))
    samples = GridSamples(grid, grid.points()[:, 0].reshape(grid.shape).astype(np.float32))
    values = samples.on(Grid(np.array([-1.0, 0.0, 0.0]), 0.5, (4, 2, 2)))
    np.testing.assert_allclose(values[:, 0, 0], [0, 0, 0, 0.4], atol=1e-6)
