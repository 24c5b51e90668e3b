"""Solves the sparse systems of convection and conduction: BiCGSTAB with incomplete LU factors without fill.

Van der Vorst 1992; Saad, "Iterative methods for sparse linear systems", 2003, section 10.3. First-order upwind matrices
are M-matrices, for which the factors exist; numbered along the flow they are nearly triangular, so the factors are
nearly exact.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, bicgstab

from dualms.errors import EvaluationFailed
from dualms.grid import Array

Index = NDArray[np.int32]


def solve_upwind(matrix: sparse.csr_array, rhs: Array, order: NDArray[np.int64], tolerance: float = 1e-7) -> Array:
    """Solve a system whose unknowns are best visited in a given order.

    Parameters
    ----------
    matrix
        (N, N) M-matrix.
    rhs
        (N,).
    order
        (N,) the unknowns, upstream first.
    tolerance
        On the residual's norm over the right side's, both after subtracting the mean temperature's share.

    Raises
    ------
    EvaluationFailed
        If the iteration does not reach the tolerance.
    """
    permuted = sparse.csr_array(matrix[order][:, order])
    permuted.sort_indices()
    right = rhs[order]
    start = np.full(len(right), right.sum() / matrix.sum())  # the uniform temperature of the same total balance
    rounding = 1e-13 * float(np.linalg.norm(permuted.diagonal() * start))
    right = right - permuted @ start
    factors, diagonal = _factorise(permuted.indptr, permuted.indices, permuted.data)

    def precondition(vector: Array) -> Array:
        return np.asarray(_back_substitute(permuted.indptr, permuted.indices, factors, diagonal, vector))

    preconditioner = LinearOperator(permuted.shape, matvec=precondition, dtype=float)
    change, failed = bicgstab(permuted, right, rtol=tolerance, atol=rounding, maxiter=500, M=preconditioner)
    if failed or not np.isfinite(change).all():
        raise EvaluationFailed(
            f"The temperatures' equations on {len(rhs)} cells did not converge.",
            advice="Raise the evaluation's resolution.",
            measured={"cells": len(rhs)},
        )
    solution = np.empty(len(rhs))
    solution[order] = start + change
    return solution


@numba.njit(cache=True)
def _factorise(starts: Index, columns: Index, values: Array) -> tuple[Array, Index]:
    """Incomplete factors in the matrix's own pattern, and where each row's diagonal stands."""
    count = len(starts) - 1
    factors = values.copy()
    diagonal = np.empty(count, np.int32)
    place = np.full(count, -1, np.int32)
    for row in range(count):
        for k in range(starts[row], starts[row + 1]):
            place[columns[k]] = k
            if columns[k] == row:
                diagonal[row] = k
        for k in range(starts[row], diagonal[row]):
            upper = columns[k]
            factors[k] /= factors[diagonal[upper]]
            for j in range(diagonal[upper] + 1, starts[upper + 1]):
                at = place[columns[j]]
                if at >= 0:
                    factors[at] -= factors[k] * factors[j]
        for k in range(starts[row], starts[row + 1]):
            place[columns[k]] = -1
    return factors, diagonal


@numba.njit(cache=True)
def _back_substitute(starts: Index, columns: Index, factors: Array, diagonal: Index, vector: Array) -> Array:
    """Solve with the factors."""
    count = len(starts) - 1
    out = np.empty(count)
    for row in range(count):
        total = vector[row]
        for k in range(starts[row], diagonal[row]):
            total -= factors[k] * out[columns[k]]
        out[row] = total
    for row in range(count - 1, -1, -1):
        total = out[row]
        for k in range(diagonal[row] + 1, starts[row + 1]):
            total -= factors[k] * out[columns[k]]
        out[row] = total / factors[diagonal[row]]
    return out
