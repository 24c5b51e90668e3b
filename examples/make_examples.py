"""Make the example domains: pipes of round section along a centre line, as binary STL in millimetres.

A straight prism is bent along the line, so both end faces stay planar and every mesh is closed by construction. And one
specification from another: the U-bend's four ports with a header on each.
"""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]
HERE = Path(__file__).parent
STEP_MM = 1.0


def main() -> None:
    """Write the three domains and the specification with headers beside this file."""
    for name, (corners, fillet, radius) in PIPES.items():
        mesh = pipe(rounded(np.array(corners, dtype=float), fillet), radius)
        (HERE / f"{name}.stl").write_bytes(trimesh.exchange.stl.export_stl(mesh))
        size = np.ptp(mesh.vertices, axis=0).round(1).tolist()
        print(f"{name}.stl: {len(mesh.faces)} faces, {size} mm, {mesh.volume / 1000:.1f} cm³")
    ports = json.loads((HERE / "u_bend_ports.json").read_text())
    (HERE / "u_bend_headers.json").write_text(json.dumps(with_headers(ports), indent=2) + "\n")


# Corners of the centre line (mm), radius of its bends (mm), radius of the section (mm).
PIPES = {
    # As long and as thick as the paper's U-shape at 0.14 m a unit.
    "u_bend": ([(0, 0, 0), (-117, 0, 0), (-117, 72, 0), (0, 72, 0)], 35.9, 23.0),
    "zigzag": ([(0, 0, 0), (60, 0, 0), (100, 60, 0), (160, 0, 0), (200, 60, 0), (260, 60, 0)], 24.0, 16.0),
    "multi_bend": ([(0, 0, 0), (70, 0, 0), (70, 70, 0), (70, 70, 70), (140, 70, 70), (140, 140, 70)], 28.0, 17.0),
}

# A stub pipe for a hose of 12 mm, with a flange; two flanges of 10 mm have room on ports 22 mm apart.
HEADER = {"radius": 6, "length": 20, "flange": {"radius": 10, "thickness": 3}}


def with_headers(spec: dict[str, Any]) -> dict[str, Any]:
    """A specification with :data:`HEADER` on every port."""
    spec = copy.deepcopy(spec)
    for fluid in spec["fluids"].values():
        for port in (*fluid["inlets"], *fluid["outlets"]):
            port["header"] = HEADER
    return spec


def rounded(corners: Array, radius: float) -> Array:
    """Polyline (K, 3) through ``corners`` with arcs of ``radius`` in place of the corners."""
    points = [corners[0]]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        back, ahead = (
            (before - corner) / np.linalg.norm(before - corner),
            (after - corner) / np.linalg.norm(after - corner),
        )
        half = np.arccos(np.clip(back @ ahead, -1, 1)) / 2
        bisector = (back + ahead) / np.linalg.norm(back + ahead)
        center = corner + bisector * radius / np.sin(half)
        start = corner + back * radius / np.tan(half) - center
        end = corner + ahead * radius / np.tan(half) - center
        turn = np.arccos(np.clip(start @ end / radius**2, -1, 1))
        angles = np.linspace(0, turn, max(2, int(np.ceil(radius * turn / STEP_MM))) + 1)
        points += [center + (np.sin(turn - a) * start + np.sin(a) * end) / np.sin(turn) for a in angles]
    return np.array([*points, corners[-1]])


def pipe(line: Array, radius: float, segments: int = 72) -> trimesh.Trimesh:
    """A round prism bent along ``line`` (K, 3), its frame carried without twist."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    tangents = np.gradient(line, lengths, axis=0)
    tangents[0], tangents[-1] = line[1] - line[0], line[-1] - line[-2]
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    normals = [np.cross(tangents[0], np.eye(3)[np.abs(tangents[0]).argmin()])]
    for tangent in tangents[1:]:
        carried = normals[-1] - tangent * (normals[-1] @ tangent)
        normals.append(carried / np.linalg.norm(carried))

    def bend(points: Array) -> Array:
        height = points[:, 2]
        at = np.stack([np.interp(height, lengths, line[:, k]) for k in range(3)], axis=1)
        n = np.stack([np.interp(height, lengths, np.array(normals)[:, k]) for k in range(3)], axis=1)
        t = np.stack([np.interp(height, lengths, tangents[:, k]) for k in range(3)], axis=1)
        n -= t * (n * t).sum(1)[:, None] / (t * t).sum(1)[:, None]
        n /= np.linalg.norm(n, axis=1)[:, None]
        b = np.cross(t / np.linalg.norm(t, axis=1)[:, None], n)
        return at + points[:, :1] * n + points[:, 1:2] * b

    divisions = int(np.ceil(lengths[-1] / (4 * STEP_MM)))
    circle = manifold3d.CrossSection.circle(radius, segments)
    bent = manifold3d.Manifold.extrude(circle, float(lengths[-1]), divisions).warp_batch(bend)
    mesh = bent.to_mesh64()
    return trimesh.Trimesh(
        np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(int), process=False
    )


if __name__ == "__main__":
    main()
