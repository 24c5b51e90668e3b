"""The artifact ``field.safetensors`` for other programs: the field at any point, in the model's own unit.

    field = read("field.safetensors")
    field.value([[10.0, 0.0, 5.0]])       # > 0 in the hot fluid, < 0 in the cold one, 0 on the separating surface
    field.gradient([[10.0, 0.0, 5.0]])    # per unit of length, towards the hot fluid

The file is what :mod:`dualms.field.field` describes, and three tensors more, which take the unit-cube frame back to the
model: ``frame.scale`` (1,) and ``frame.offset`` (3,) in the model's unit, ``frame.unit_m`` (1,), metres a unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save as to_bytes
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.special import expit

from dualms.domain import Domain
from dualms.field.field import Field, load_field, save_field
from dualms.field.network import Network
from dualms.field.samples import GridSamples
from dualms.spec import Unit

Array = NDArray[np.float64]

_SCALE, _OFFSET, _UNIT = "frame.scale", "frame.offset", "frame.unit_m"
_CHUNK = 16_384  # points that a network's gradient is taken at together


@dataclass(frozen=True)
class FieldFile:
    """A field in the frame of the model that it was made for.

    Parameters
    ----------
    field
        As it was solved, in the unit-cube frame.
    scale, offset
        Model units a unit of that frame, and (3,) the place of its origin in the model.
    units
        The model's unit.
    """

    field: Field
    scale: float
    offset: Array
    units: Unit

    def value(self, points: ArrayLike) -> Array:
        """(P,) the field at points (P, 3) in the model's unit: positive in the hot fluid, negative in the cold one.

        Near the separating surface a phase field is close to the signed distance to it over ``scale``; a network has
        no such scale. Beyond the samples (a margin round the domain) a phase field is constant.
        """
        places = self._places(points)
        if isinstance(self.field.source, Network):
            return self.field.source.at(places).astype(np.float64)
        return np.asarray(self._spline(self._clamped(places)))

    def gradient(self, points: ArrayLike) -> Array:
        """(P, 3) the field's gradient at points (P, 3), per model unit; exact for what :meth:`value` returns."""
        places = self._places(points)
        if isinstance(self.field.source, Network):
            parts = [places[start : start + _CHUNK] for start in range(0, len(places), _CHUNK)]
            slopes = [np.zeros((0, 3)), *(_slope(self.field.source, part) for part in parts)]
            return np.concatenate(slopes) / self.scale
        clamped = self._clamped(places)
        along = [self._spline(clamped, nu=nu) for nu in np.eye(3, dtype=int).tolist()]
        return np.where(clamped == places, np.stack(along, axis=1), 0.0) / self.scale

    @property
    def method(self) -> str:
        """The method of the specification that made the field."""
        return self.field.method

    @property
    def voxel(self) -> float | None:
        """Distance between two samples, model units; None for a network."""
        source = self.field.source
        return source.grid.spacing * self.scale if isinstance(source, GridSamples) else None

    def _places(self, points: ArrayLike) -> Array:
        given = np.asarray(points, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != 3 or not np.isfinite(given).all():
            raise ValueError(f"points must be finite (P, 3), not {given.shape}")
        return np.asarray((given - self.offset) / self.scale)

    @cached_property
    def _samples(self) -> GridSamples:
        if not isinstance(self.field.source, GridSamples):
            raise TypeError("a network has no samples")
        return self.field.source

    @cached_property
    def _spline(self) -> NdBSpline:
        """The tensor-product cubic spline that the surface is taken from, too."""
        coefficients = self._samples.values.astype(np.float64)
        knots = []
        for axis, places in enumerate(self._samples.grid.axes()):
            line = make_interp_spline(places, coefficients, k=3, axis=axis)
            coefficients = np.moveaxis(line.c, 0, axis)
            knots.append(line.t)
        return NdBSpline(tuple(knots), np.ascontiguousarray(coefficients), 3)

    def _clamped(self, places: Array) -> Array:
        axes = self._samples.grid.axes()
        return np.clip(places, [axis[0] for axis in axes], [axis[-1] for axis in axes])


def read(path: Path | str) -> FieldFile:
    """Read an artifact ``field.safetensors``.

    Raises
    ------
    ValueError
        If the file is no field, or one without its model's frame (made by ``save_field`` alone).
    """
    try:
        field = load_field(Path(path))
        with safe_open(path, framework="numpy") as file:
            scale, offset, unit_m = (file.get_tensor(name) for name in (_SCALE, _OFFSET, _UNIT))
    except SafetensorError as error:
        raise ValueError(f"{path} is not a field of a design: {error}") from None
    units = next((unit for unit in Unit if unit.metres == float(unit_m.item())), None)
    if units is None:
        raise ValueError(f"{path} has a unit of {float(unit_m.item())} m, which is none of ours")
    return FieldFile(field, float(scale.item()), offset.astype(np.float64), units)


def write(field: Field, domain: Domain, units: Unit, path: Path) -> None:
    """Write a field with the frame of its model; the same field gives the same bytes.

    Parameters
    ----------
    field
        In the domain's unit-cube frame.
    domain
        Its frame.
    units
        The model's unit.
    path
        Of the artifact; :func:`dualms.field.field.load_field` reads it as well.
    """
    bare = path.with_name(path.name + ".bare")
    save_field(field, bare)
    with safe_open(bare, framework="numpy") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    tensors[_SCALE] = np.array([domain.scale_m / units.metres])
    tensors[_OFFSET] = np.asarray(domain.offset_m / units.metres, dtype=np.float64)
    tensors[_UNIT] = np.array([units.metres])
    bare.write_bytes(to_bytes(tensors, metadata=metadata))
    bare.replace(path)


def _slope(network: Network, points: Array) -> Array:
    """(P, 3) gradient of a network at points (P, 3) of its frame, by the chain rule from its end."""
    frequencies = network.frequencies.astype(np.float64)
    phase = 2 * np.pi * (points @ frequencies)
    layers = [(weight.astype(np.float64), bias.astype(np.float64)) for weight, bias in network.layers]
    x, inner = np.concatenate([np.sin(phase), np.cos(phase)], axis=1), []
    for weight, bias in layers[:-1]:
        inner.append(x @ weight + bias)
        x = np.logaddexp(0, inner[-1])
    back = np.broadcast_to(layers[-1][0][:, 0], x.shape)
    for (weight, _), z in zip(reversed(layers[:-1]), reversed(inner), strict=True):
        back = (back * expit(z)) @ weight.T
    sines, cosines = np.split(back, 2, axis=1)
    return np.asarray(2 * np.pi * (sines * np.cos(phase) - cosines * np.sin(phase)) @ frequencies.T)
