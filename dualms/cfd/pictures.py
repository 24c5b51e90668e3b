"""The picture of an evaluation: streamlines coloured by speed, and the walls coloured by pressure, for both fluids."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import mitsuba
import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from dualms.cfd.channels import COLD, HOT, VoxelExchanger
from dualms.cfd.exchanger import SolvedExchanger, SolvedFluid
from dualms.cfd.streamlines import streamlines, tubes
from dualms.grid import Array, Grid
from dualms.surface import level_set
from dualms.triangles import TriangleMesh

LINES = 160
SAMPLES_PER_PIXEL = 9
SIZE = (760, 520)


def flow_picture(solved: SolvedExchanger, path: Path) -> None:
    """Write ``evaluation.png``.

    Parameters
    ----------
    solved
        Both fluids.
    path
        A PNG file.
    """
    figure = Figure(figsize=(14, 9.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    sides = ((HOT, "hot", solved.hot), (COLD, "cold", solved.cold))
    camera = _camera(np.argwhere(solved.exchanger.labels != 0).astype(float))
    for column, (sign, name, side) in enumerate(sides):
        mesh, value = _wall(solved.exchanger, sign, side)
        top = float(np.quantile(value, 0.995))
        _panel(axes[0, column], camera, mesh, value, (min(0.0, float(value.min())), top), "coolwarm")
        _bar(figure, axes[0, column], (min(0.0, float(value.min())), top), "coolwarm", "pressure over outlet, Pa")
        axes[0, column].set_title(f"{name}: ΔP {side.flow.pressure_drop_pa:.4g} Pa ({side.flow.state})")
        lines = streamlines(side.mesh, side.flow.velocity_m_s, solved.exchanger.labels.shape, LINES)
        points, faces, speed = tubes(lines, 0.22)
        span = (0.0, float(np.quantile(speed, 0.98)))
        _panel(axes[1, column], camera, TriangleMesh(points, faces), speed, span, "viridis")
        _bar(figure, axes[1, column], span, "viridis", "speed, m/s")
        axes[1, column].set_title(f"{name}: leaves at {side.heat.outlet_k:.2f} K")
    figures = solved.figures
    figure.suptitle(
        f"Quick evaluation, for ranking: duty {figures.duty_w:.4g} W, UA {figures.ua_w_k:.4g} W/K, "
        f"pumping {figures.pumping_power_w:.3g} W"
    )
    figure.savefig(path, dpi=110)


def problem_picture(message: str, path: Path) -> None:
    """Write ``evaluation.png`` where there is no flow to show: the reason."""
    figure = Figure(figsize=(10, 3), layout="constrained")
    FigureCanvasAgg(figure)
    text = "The flow could not be solved.\n\n" + "\n".join(textwrap.wrap(message, 90))
    figure.text(0.5, 0.5, text, ha="center", va="center")
    figure.savefig(path, dpi=110)


def _wall(exchanger: VoxelExchanger, sign: int, side: SolvedFluid) -> tuple[TriangleMesh, Array]:
    """A fluid's boundary in lattice coordinates, and the pressure at its vertices."""
    fluid = exchanger.labels == sign
    depth = (sign * exchanger.distance_m - exchanger.wall_m / 2) / exchanger.spacing_m
    depth = np.where(fluid, np.maximum(depth, 0.05), np.where(exchanger.labels == 0, -0.5, np.minimum(depth, -0.05)))
    surface = level_set(depth.astype(np.float32), Grid(np.zeros(3), 1.0, exchanger.labels.shape))
    pressure = np.zeros(exchanger.labels.shape)
    pressure[tuple(side.mesh.cells.T)] = side.flow.pressure_pa
    nearest = ndimage.distance_transform_edt(~fluid, return_distances=False, return_indices=True)
    at = np.clip(np.rint(surface.vertices).astype(int), 0, np.array(exchanger.labels.shape) - 1)
    return surface, pressure[tuple(nearest[:, *at.T])]


def _panel(
    axes: Any, camera: dict[str, Any], mesh: TriangleMesh, value: Array, span: tuple[float, float], colours: str
) -> None:
    low, high = span
    shade = colormaps[colours](np.clip((value - low) / max(high - low, 1e-30), 0, 1))[:, :3]
    linear = np.where(shade <= 0.04045, shade / 12.92, ((shade + 0.055) / 1.055) ** 2.4)
    axes.imshow(_render(mesh, linear, camera))
    axes.set_axis_off()


def _bar(figure: Figure, axes: Any, span: tuple[float, float], colours: str, label: str) -> None:
    figure.colorbar(ScalarMappable(Normalize(*span), colours), ax=axes, label=label, shrink=0.7)


def _render(mesh: TriangleMesh, colours: Array, camera: dict[str, Any]) -> NDArray[np.uint8]:
    """A picture of a mesh with a linear RGB colour (V, 3) a vertex, on white."""
    if mitsuba.variant() != "scalar_rgb":
        mitsuba.set_variant("scalar_rgb")
    made = mitsuba.Mesh("coloured", len(mesh.vertices), len(mesh.faces), props=_material())
    made.add_attribute("vertex_color", 3, colours.astype(np.float32).ravel().tolist())
    parameters = mitsuba.traverse(made)
    parameters["vertex_positions"] = ((mesh.vertices - camera["target"]) / camera["radius"]).astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    origin = 3.6 * camera["direction"]
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "hide_emitters": True},
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.6}},
            "sun": {"type": "directional", "direction": camera["sun"].tolist(), "irradiance": 1.2},
            "sensor": {
                "type": "perspective",
                "fov": 27.0,
                "fov_axis": "smaller",
                "to_world": mitsuba.ScalarTransform4f().look_at(origin.tolist(), [0, 0, 0], camera["up"].tolist()),
                "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "pixel_format": "rgba"},
                "sampler": {"type": "multijitter", "sample_count": SAMPLES_PER_PIXEL},
            },
            "mesh": made,
        }
    )
    pixels = np.array(mitsuba.render(scene))
    light = np.clip(pixels[..., :3] + (1 - pixels[..., 3:]), 0, 1)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(255 * encoded + 0.5).astype(np.uint8)


def _material() -> Any:
    properties = mitsuba.Properties()
    inner = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "inner": inner})
    return properties


def _camera(points: Array) -> dict[str, Any]:
    """A view from above the two longest sides."""
    low, high = points.min(axis=0), points.max(axis=0)
    order = np.argsort(high - low)
    axes = np.eye(3)
    up, side, along = axes[order[0]], axes[order[1]], axes[order[2]]
    handed = np.sign(np.linalg.det(np.stack([along, side, up])))
    direction = 1.6 * up - handed * side - 0.25 * along
    direction /= np.linalg.norm(direction)
    return {
        "target": (low + high) / 2,
        "radius": float(np.linalg.norm(high - low)) / 2,
        "direction": direction,
        "up": up,
        "sun": -direction + 0.4 * along + 0.25 * side,
    }
