"""Maps of the separating surface: mean curvature, and the wall's thickness by true distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dualms.body.body import Body
from dualms.body.patches import INTERFACE
from dualms.measure.printing import beside_the_shell, to_cold
from dualms.render import camera, decoded, render
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

INCHES = 6.4  # across a map, for its text: that shrinks with the picture
UNKNOWN = (0.75, 0.75, 0.75)  # where there is no fit, or no wall of its own


def maps(surface: TriangleMesh, curvature: Array, body: Body, path: Path, width: int = 640) -> None:
    """Write ``maps.png``.

    Parameters
    ----------
    surface
        The separating surface, metres.
    curvature
        (V,) mean curvature at its vertices, 1/m.
    body
        In metres.
    path
        A PNG file.
    width
        Pixels across each of the two maps.
    """
    figure = Figure(figsize=(2 * INCHES, 0.66 * INCHES), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    curvature = curvature / 1e3
    limit = float(np.nanquantile(np.abs(curvature), 0.95)) if np.isfinite(curvature).any() else 1.0
    wall = body.hot.mesh.part(body.hot.patch == INTERFACE)
    thickness = 1e3 * np.where(beside_the_shell(wall.vertices, body), np.nan, to_cold(wall.vertices, body))
    known = thickness[np.isfinite(thickness)]
    low, high = np.quantile(known, (0.01, 0.99)) if len(known) else (0.0, 1.0)
    panels = (
        (surface, curvature, (-limit, limit), "coolwarm", "Mean curvature of the separating surface", "H, 1/mm"),
        (wall, thickness, (0.97 * low, 1.03 * high), "viridis", "Thickness of the wall", "mm"),
    )
    for axis, (mesh, values, span, colours, title, label) in zip(axes, panels, strict=True):
        axis.imshow(_painted(mesh, values, span, colours, (width, int(0.66 * width))))
        axis.set_axis_off()
        axis.set_title(title, fontsize=15)
        bar = figure.colorbar(ScalarMappable(Normalize(*span), colours), ax=axis, shrink=0.85, pad=0.01)
        bar.set_label(label, fontsize=13)
        bar.ax.tick_params(labelsize=12)
    figure.savefig(path, dpi=width / INCHES)


def _painted(
    mesh: TriangleMesh, values: Array, span: tuple[float, float], colours: str, size: tuple[int, int]
) -> NDArray[np.uint8]:
    low, high = span
    shade = colormaps[colours](np.clip((np.nan_to_num(values) - low) / max(high - low, 1e-30), 0, 1))[:, :3]
    shade[~np.isfinite(values)] = UNKNOWN
    shown = mesh.moved(1 / float(np.ptp(mesh.vertices, axis=0).max()), np.zeros(3))
    return np.asarray(render([(shown, decoded(shade))], camera(shown.vertices, size), size))
