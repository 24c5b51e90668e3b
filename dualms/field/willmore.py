"""The way to H = 0: descent on the diffuse Willmore energy.

Least area pulls thin necks shut: minimal surfaces of these topologies are saddle points of the area. They are minima of
E(u) = 1/(2ε) ∫ w², w = -εΔu + W'(u)/ε, W = (1 - u²)²/4, an approximation of ∫ (2H)² over the interface, so nothing
collapses.

References
----------
De Giorgi 1991, "Some remarks on Γ-convergence and least squares method"; Röger and Schätzle 2006, "On a modified
conjecture of De Giorgi".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


@njit(parallel=True, cache=True)  # type: ignore[untyped-decorator]
def _residual(u: Floats, mask: Mask, eps: float, spacing: float, w: Floats) -> NDArray[np.float64]:
    """Fill w = -εΔu + (u³ - u)/ε, no flux out of the mask; return ∫ w² by slabs, in squared spacings."""
    nx, ny, nz = u.shape
    squares = np.zeros(nx)
    a = np.float32(eps / spacing**2)
    b = np.float32(1 / eps)
    for i in prange(1, nx - 1):
        total = 0.0
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                if not mask[i, j, k]:
                    continue
                c = u[i, j, k]
                lap = np.float32(0)
                if mask[i - 1, j, k]:
                    lap += u[i - 1, j, k] - c
                if mask[i + 1, j, k]:
                    lap += u[i + 1, j, k] - c
                if mask[i, j - 1, k]:
                    lap += u[i, j - 1, k] - c
                if mask[i, j + 1, k]:
                    lap += u[i, j + 1, k] - c
                if mask[i, j, k - 1]:
                    lap += u[i, j, k - 1] - c
                if mask[i, j, k + 1]:
                    lap += u[i, j, k + 1] - c
                r = -a * lap + b * (c * c - np.float32(1)) * c
                w[i, j, k] = r
                total += r * r
        squares[i] = total
    return squares


@njit(parallel=True, cache=True)  # type: ignore[untyped-decorator]
def _gradient(u: Floats, w: Floats, mask: Mask, eps: float, spacing: float, g: Floats) -> None:
    """Fill g = -Δw + W''(u) w/ε², the derivative of the energy."""
    nx, ny, nz = u.shape
    a = np.float32(1 / spacing**2)
    b = np.float32(1 / eps**2)
    for i in prange(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                if not mask[i, j, k]:
                    continue
                c = w[i, j, k]
                lap = np.float32(0)
                if mask[i - 1, j, k]:
                    lap += w[i - 1, j, k] - c
                if mask[i + 1, j, k]:
                    lap += w[i + 1, j, k] - c
                if mask[i, j - 1, k]:
                    lap += w[i, j - 1, k] - c
                if mask[i, j + 1, k]:
                    lap += w[i, j + 1, k] - c
                if mask[i, j, k - 1]:
                    lap += w[i, j, k - 1] - c
                if mask[i, j, k + 1]:
                    lap += w[i, j, k + 1] - c
                v = u[i, j, k]
                g[i, j, k] = -a * lap + b * (np.float32(3) * v * v - np.float32(1)) * c


@dataclass(frozen=True)
class Willmore:
    """The diffuse Willmore energy on the voxels of a mask.

    Parameters
    ----------
    mask
        (nx, ny, nz) where the energy is taken; False on the outermost voxels of the box.
    eps
        ε of the interface, unit-cube units.
    spacing
        Edge of a voxel, unit-cube units.
    """

    mask: Mask
    eps: float
    spacing: float

    def __post_init__(self) -> None:
        inner = self.mask[1:-1, 1:-1, 1:-1]
        if inner.sum() != self.mask.sum():
            raise ValueError("the mask must leave the box's outermost voxels free")

    def energy(self, u: Floats) -> tuple[float, Floats]:
        """E(u) and its gradient (a function on the voxels: the derivative over the voxel's volume)."""
        w = np.zeros_like(u)
        squares = _residual(u, self.mask, self.eps, self.spacing, w)
        g = np.zeros_like(u)
        _gradient(u, w, self.mask, self.eps, self.spacing, g)
        return float(squares.sum()) * self.spacing**3 / (2 * self.eps), g

    def preconditioner(self) -> Callable[[Floats], Floats]:
        """An inverse of the energy's second derivative far from the interface, in the box's cosine basis."""
        wave2 = [
            (2 - 2 * np.cos(np.pi * np.arange(n) / n)).astype(np.float32) / np.float32(self.spacing**2)
            for n in self.mask.shape
        ]
        k2 = wave2[0][:, None, None] + wave2[1][None, :, None] + wave2[2][None, None, :]
        symbol = 1 / (self.eps * k2 * k2 + 2 * k2 / self.eps + 1 / (2 * self.eps**3))
        mask = self.mask

        def apply(g: Floats) -> Floats:
            spectrum = dctn(g, type=2, norm="ortho", workers=2, overwrite_x=False)
            spectrum *= symbol
            out = idctn(spectrum, type=2, norm="ortho", workers=2, overwrite_x=True)
            out *= mask
            return np.asarray(out, dtype=np.float32)

        return apply
