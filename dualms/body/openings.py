"""The core that the shell leaves free for each fluid: the domain less a skin, open where the fluid's ports are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import WallTooThick
from dualms.grid import Grid
from dualms.narrow_band import band_distance
from dualms.ports import SAME_SIDE, Port
from dualms.surface import Sheet, level_set
from dualms.triangles import TriangleMesh

Values = NDArray[np.float32]
SMOOTH = np.cos(np.radians(30))  # neighbours that turn by less belong to the same face of the envelope
CLEARANCE_VOXELS = 0.1  # between an opening and the bore of a header that it leads into
TOLERANCE_VOXELS = 0.05  # of the core's faces: where the shell is flat, a few large ones do
MARGIN_VOXELS = 1.5  # further from where an opening ends its distance does not matter
OVERLAP_VOXELS = 1.5  # how far above the skin such an opening ends; the bore starts at one voxel


def core(
    domain: Domain,
    sheet: Sheet,
    shell: float,
    fluid: int,
    outside: bool = False,
    piped: frozenset[int] = frozenset(),
) -> Solid:
    """Where a fluid may be: clear of the shell, or under one of its ports.

    Under a port the shell still stands along the envelope's other faces, so an opening that takes a whole end face
    keeps the side walls.

    Parameters
    ----------
    domain
        The envelope and its ports.
    sheet
        Holds the depth below the envelope, exact for ``shell`` and two voxels more on both sides.
    shell
        Thickness, unit-cube units.
    fluid
        1 hot, -1 cold.
    outside
        Whether the shell stands outside the envelope.
    piped
        Ports (by index) whose openings go on in a header: they end within it, above the skin.

    Returns
    -------
    Solid
        Reaches beyond the skin at the openings, so that the body's outline cuts it there.

    Raises
    ------
    WallTooThick
        If a shell inside fills the domain.
    """
    grid = sheet.grid
    free = np.full(grid.shape, -1, dtype=np.float32) if outside else sheet.depth - np.float32(shell)
    if not outside and not (free > 0).any():
        raise WallTooThick(
            f"A shell of {shell:.3g} of the domain's longest side fills the domain.",
            advice="Make the shell thinner.",
            measured={"shell_over_longest_side": shell},
        )
    for index, port in enumerate(domain.ports):
        if port.fluid == fluid:
            _open(domain, port, free, sheet, shell, outside, index in piped)
    opened = Solid.of(level_set(free, grid)).simplified(TOLERANCE_VOXELS * grid.spacing)
    # A body of its own for each fluid, so that faces tell which fluid they were cut for.
    return Solid.of(domain.boundary) | opened if outside else opened


def _open(domain: Domain, port: Port, free: Values, sheet: Sheet, shell: float, outside: bool, piped: bool) -> None:
    """Raise ``free`` to the opening of one port, in place; exact next to where either changes its sign."""
    grid = sheet.grid
    reach, margin = shell + 2 * grid.spacing, MARGIN_VOXELS * grid.spacing
    low = np.maximum(grid.nearest((port.samples.min(axis=0) - reach)[None])[0], 0)
    high = grid.nearest((port.samples.max(axis=0) + reach)[None])[0] + 1
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    nx, ny, nz = high - low
    local = Grid(grid.origin + grid.spacing * low, grid.spacing, (nx, ny, nz))
    above = band_distance(TriangleMesh(domain.vertices, domain.faces[port.triangles]), local, reach + margin)
    near = above < reach + margin
    points, above = local.points(near), above[near]
    opening = np.minimum(port.lateral(points), reach - above)
    others = domain.faces[~_face_of(domain, port)]
    if len(others):
        beside = band_distance(TriangleMesh(domain.vertices, others), local, reach + 2 * margin)[near]
        if outside:
            # Over a face, the root of the difference is the way to its rim; beyond the rim it is zero.
            opening = np.minimum(opening, np.sqrt(np.maximum(beside**2 - above**2, 0)) - grid.spacing)
        else:
            opening = np.minimum(opening, beside - shell)
    if piped:
        skin = shell if outside else 0.0
        # Within the bore, whose outline it would otherwise meet face to face, and not far into it.
        opening = np.minimum(opening, port.lateral(points) - CLEARANCE_VOXELS * grid.spacing)
        opening = np.minimum(opening, sheet.depth[box][near] + skin + OVERLAP_VOXELS * grid.spacing)
    free[box][near] = np.maximum(free[box][near], opening.astype(np.float32))


def _face_of(domain: Domain, port: Port) -> NDArray[np.bool_]:
    """(F,) the smooth part of the boundary that the port lies on: what turns away by little, from edge to edge."""
    mesh = domain.boundary
    normals = mesh.crosses / np.maximum(np.linalg.norm(mesh.crosses, axis=1), 1e-300)[:, None]
    edges = np.sort(np.concatenate([domain.faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    _, inverse = np.unique(edges, axis=0, return_inverse=True)
    pairs = np.argsort(inverse.reshape(-1), kind="stable").reshape(-1, 2) % len(domain.faces)
    same_side = normals @ port.normal > SAME_SIDE
    smooth = np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > SMOOTH
    smooth &= same_side[pairs].all(axis=1)
    links = coo_array((np.ones(int(smooth.sum())), tuple(pairs[smooth].T)), shape=(len(normals),) * 2)
    _, label = connected_components(links, directed=False)
    # A box may also catch a rim of the side walls: those do not open.
    facing = port.triangles[same_side[port.triangles]]
    return np.asarray(np.isin(label, np.unique(label[facing])) & same_side)
