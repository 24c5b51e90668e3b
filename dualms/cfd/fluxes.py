"""Makes solved fluxes conserve volume in every cell exactly, so that a heat balance on them closes.

The least change of the fluxes that does so is a gradient: a Poisson equation on the cells (the projection of Chorin
1968).
"""

from __future__ import annotations

import numpy as np
import pyamg
from scipy import sparse
from scipy.sparse.linalg import cg

from dualms.cfd.mesh import ChannelMesh
from dualms.grid import Array


def divergence(mesh: ChannelMesh, flux_m3_s: Array) -> Array:
    """(N,) net volume flow out of each cell, m³/s."""
    inner = len(mesh.neighbour)
    count = len(mesh.cells)
    out = np.bincount(mesh.owner, flux_m3_s, minlength=count)
    return np.asarray(out - np.bincount(mesh.neighbour, flux_m3_s[:inner], minlength=count))


def conservative(mesh: ChannelMesh, flux_m3_s: Array, tolerance: float = 1e-7) -> Array:
    """Fluxes (F,) nearest to given ones that leave no cell with a net outflow.

    Inlets and walls keep theirs; internal faces and outlets are corrected.

    Parameters
    ----------
    mesh
        Cells and faces.
    flux_m3_s
        (F,) along the faces' normals.
    tolerance
        Of what is left, over the total inflow's norm.
    """
    inner, outlet = len(mesh.neighbour), mesh.patch("outlet")
    own, other = mesh.owner[:inner], mesh.neighbour
    count = len(mesh.cells)
    degree = np.bincount(own, minlength=count) + np.bincount(other, minlength=count)
    degree = degree + 2.0 * np.bincount(mesh.owner[outlet], minlength=count)  # half a cell to the outlet
    rows = np.concatenate([own, other, np.arange(count)])
    columns = np.concatenate([other, own, np.arange(count)])
    values = np.concatenate([-np.ones(2 * inner), degree])
    matrix = sparse.coo_array((values, (rows, columns)), shape=(count, count)).tocsr()
    levels = pyamg.ruge_stuben_solver(sparse.csr_matrix(matrix), max_coarse=200)
    excess = divergence(mesh, flux_m3_s)
    inflow = float(np.abs(flux_m3_s[mesh.patch("inlet")]).sum())
    potential, _ = cg(matrix, -excess, rtol=0.0, atol=tolerance * inflow, maxiter=200, M=levels.aspreconditioner())
    corrected = flux_m3_s.copy()
    corrected[:inner] += potential[own] - potential[other]
    corrected[outlet] += 2.0 * potential[mesh.owner[outlet]]
    return corrected
