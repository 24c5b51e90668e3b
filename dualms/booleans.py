"""Exact booleans of closed meshes, with the origin of every resulting triangle (manifold3d)."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np
from numpy.typing import NDArray

from dualms.errors import InvalidBody
from dualms.triangles import TriangleMesh, used_only


@dataclass(frozen=True)
class Solid:
    """A closed body; ``a & b`` intersects, ``a | b`` unites, ``a - b`` subtracts.

    ``origin`` identifies the body's own triangles in whatever is made of it.
    """

    manifold: manifold3d.Manifold
    origin: int

    @classmethod
    def of(cls, mesh: TriangleMesh) -> Solid:
        """A body from a closed, outward oriented mesh.

        Raises
        ------
        InvalidBody
            If the mesh is not closed and manifold, or inside out.
        """
        return cls.of_parts(mesh, np.zeros(len(mesh.faces), dtype=np.int64))

    @classmethod
    def of_parts(cls, mesh: TriangleMesh, part: NDArray[np.int64]) -> Solid:
        """A body whose triangles are told apart: those of ``part`` k (F,) have the origin ``origin + k``.

        Raises
        ------
        InvalidBody
            If the mesh is not closed and manifold, or inside out.
        """
        order = np.argsort(part, kind="stable")
        parts, first = np.unique(part[order], return_index=True)
        origin = manifold3d.Manifold.reserve_ids(int(parts.max(initial=0)) + 1)
        manifold = manifold3d.Manifold(
            manifold3d.Mesh64(
                vert_properties=np.ascontiguousarray(mesh.vertices, dtype=np.float64),
                tri_verts=np.ascontiguousarray(mesh.faces[order], dtype=np.uint64),
                run_index=3 * np.append(first, len(order)).astype(np.uint64),
                run_original_id=(origin + parts).astype(np.uint32),
            )
        )
        if manifold.status() != manifold3d.Error.NoError:
            raise InvalidBody(
                f"A mesh of {len(mesh.faces):,} triangles is no closed body: {manifold.status().name}.",
                advice="If this is your domain, repair it in CAD; otherwise change surface.resolution a little.",
            )
        if manifold.volume() < 0:
            raise InvalidBody(
                f"A mesh of {len(mesh.faces):,} triangles is inside out.",
                advice="Turn its triangles the other way round, so that their normals point outward.",
            )
        return cls(manifold, origin)

    @classmethod
    def empty(cls) -> Solid:
        """The body without points."""
        return cls(manifold3d.Manifold(), -1)

    def __and__(self, other: Solid) -> Solid:
        return Solid(self.manifold ^ other.manifold, -1)

    def __or__(self, other: Solid) -> Solid:
        return Solid(self.manifold + other.manifold, -1)

    def __sub__(self, other: Solid) -> Solid:
        return Solid(self.manifold - other.manifold, -1)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left."""
        return bool(self.manifold.is_empty())

    @property
    def volume(self) -> float:
        """Enclosed volume."""
        return float(self.manifold.volume())

    @property
    def faces(self) -> int:
        """Number of triangles."""
        return int(self.manifold.num_tri())

    def simplified(self, tolerance: float) -> Solid:
        """The body with triangles merged that lie within a tolerance of a common plane; its origins stay."""
        return Solid(self.manifold.simplify(tolerance), self.origin)

    def bodies(self) -> list[Solid]:
        """The connected bodies, largest first."""
        parts = [Solid(part, -1) for part in self.manifold.decompose()]
        return sorted(parts, key=lambda part: -part.volume)

    def mesh(self) -> TriangleMesh:
        """The boundary as a mesh."""
        return self.faces_by_origin()[0]

    def faces_by_origin(self) -> tuple[TriangleMesh, NDArray[np.int64]]:
        """The boundary, and for each triangle (F,) the ``origin`` of the body that it was cut from."""
        mesh = self.manifold.to_mesh64()
        faces = np.asarray(mesh.tri_verts, dtype=np.int64)
        vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
        if len(mesh.merge_from_vert):
            target = np.arange(len(vertices))
            target[np.asarray(mesh.merge_from_vert)] = np.asarray(mesh.merge_to_vert)
            faces = target[faces]
        runs = np.asarray(mesh.run_index, dtype=np.int64) // 3
        origin = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), np.diff(runs))
        return used_only(vertices, faces), origin
