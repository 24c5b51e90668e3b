"""Saving and loading of the frozen values that pass between stages.

One file a value: arrays as safetensors, everything else as JSON in its header. The same value gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

T = TypeVar("T")


def save(value: object, path: Path) -> None:
    """Write a frozen dataclass of arrays, scalars, strings, tuples and other such dataclasses to one file."""
    arrays: dict[str, np.ndarray] = {}
    tree = _flatten(value, "value", arrays)
    # One metadata entry only: safetensors writes several in no fixed order.
    metadata = {"dualms": json.dumps({"type": type(value).__name__, "tree": tree}, sort_keys=True)}
    partial = path.with_name(path.name + ".partial")
    save_file(arrays, partial, metadata=metadata)
    partial.replace(path)


def load(kind: type[T], path: Path) -> T:
    """Read a value written by :func:`save`.

    Raises
    ------
    ValueError
        If the file holds a value of another type.
    """
    with safe_open(path, framework="numpy") as file:
        header = json.loads((file.metadata() or {}).get("dualms", "{}"))
        if header.get("type") != kind.__name__:
            raise ValueError(f"{path.name} holds a {header.get('type')}, not a {kind.__name__}")
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    return typing.cast("T", _restore(kind, header["tree"], arrays))


def _flatten(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, np.ndarray):
        arrays[name] = np.ascontiguousarray(value)
        return {"array": name}
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.init]
        return {"fields": {f: _flatten(getattr(value, f), f"{name}.{f}", arrays) for f in fields}}
    if isinstance(value, tuple):
        return {"items": [_flatten(v, f"{name}.{i}", arrays) for i, v in enumerate(value)]}
    if isinstance(value, dict):
        return {"entries": {k: _flatten(v, f"{name}.{k}", arrays) for k, v in value.items()}}
    return {"scalar": value}


def _restore(kind: Any, tree: dict[str, Any], arrays: dict[str, np.ndarray]) -> Any:
    if "array" in tree:
        return arrays[tree["array"]]
    if "scalar" in tree:
        return tree["scalar"]
    kind = _concrete(kind)
    if "items" in tree:
        item = (typing.get_args(kind) or (Any,))[0]
        return tuple(_restore(item, t, arrays) for t in tree["items"])
    if "entries" in tree:
        item = (typing.get_args(kind) or (Any, Any))[-1]
        return {k: _restore(item, t, arrays) for k, t in tree["entries"].items()}
    hints = typing.get_type_hints(kind)
    return kind(**{k: _restore(hints[k], t, arrays) for k, t in tree["fields"].items()})


def _concrete(kind: Any) -> Any:
    """The one type that is not None in an optional."""
    if isinstance(kind, types.UnionType) or typing.get_origin(kind) is typing.Union:
        return next(k for k in typing.get_args(kind) if k is not type(None))
    return kind
