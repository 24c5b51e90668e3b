"""What every field solver returns: a scalar field that can be evaluated on any grid, and its file.

The file ``field.safetensors`` holds tensors and one metadata entry, ``dualms``, a JSON object with ``format`` (1),
``kind``, ``method``, ``device`` and ``columns``; the tensor ``history`` (R, C) float64 has one row a logged iteration.

- ``kind`` = ``"grid"``: ``values`` (nx, ny, nz) float32 at ``origin`` (3,) + ``spacing`` (1,)·(i, j, k),
  unit-cube frame; cubic splines between the samples, constant beyond them.
- ``kind`` = ``"network"``: ``frequencies`` (3, m), ``weight.0`` (2m, w), ``bias.0`` (w,), … ``weight.n`` (w, 1),
  ``bias.n`` (1,), all float32: f(x) = MLP([sin 2πxB, cos 2πxB]), softplus between the layers; x in the unit-cube frame.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import save as to_bytes

from dualms.field.network import Network
from dualms.field.samples import GridSamples
from dualms.grid import Grid

FORMAT = 1


@dataclass(frozen=True)
class History:
    """Figures logged while solving.

    Parameters
    ----------
    columns
        Names, the first of which is ``"iteration"``.
    rows
        (R, C) float64.
    """

    columns: tuple[str, ...]
    rows: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.rows.ndim != 2 or self.rows.shape[1] != len(self.columns):
            raise ValueError(f"history has columns {self.columns} but rows of shape {self.rows.shape}")

    def column(self, name: str) -> NDArray[np.float64]:
        """(R,) values of one column."""
        return self.rows[:, self.columns.index(name)]


@dataclass(frozen=True)
class Field:
    """A scalar field on the domain and a margin round it; positive in the hot fluid, negative in the cold one.

    Parameters
    ----------
    source
        Samples on a grid, or a network.
    method
        The method of the specification that made it.
    history
        What the solver logged.
    device
        Where it was solved: ``"cpu"`` or the name of the GPU.
    """

    source: GridSamples | Network
    method: str
    history: History
    device: str

    def on(self, grid: Grid) -> NDArray[np.float32]:
        """Values (nx, ny, nz) float32 at the voxel centres of ``grid`` (unit-cube frame)."""
        return self.source.on(grid)


def save_field(field: Field, path: Path) -> None:
    """Write a field; the same field gives the same bytes."""
    # One metadata entry only: safetensors writes several in no fixed order.
    header = {
        "format": FORMAT,
        "kind": "grid" if isinstance(field.source, GridSamples) else "network",
        "method": field.method,
        "device": field.device,
        "columns": list(field.history.columns),
    }
    tensors = {**field.source.tensors(), "history": np.ascontiguousarray(field.history.rows)}
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(to_bytes(tensors, metadata={"dualms": json.dumps(header, sort_keys=True)}))
    partial.replace(path)


def load_field(path: Path) -> Field:
    """Read a field written by :func:`save_field`.

    Raises
    ------
    ValueError
        If the file is of another format.
    """
    with safe_open(path, framework="numpy") as file:
        header = json.loads((file.metadata() or {}).get("dualms", "{}"))
        if header.get("format") != FORMAT:
            raise ValueError(f"{path.name} is not a field of format {FORMAT}")
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    history = History(tuple(header["columns"]), tensors.pop("history"))
    kind = GridSamples if header["kind"] == "grid" else Network
    return Field(kind.from_tensors(tensors), header["method"], history, header["device"])
