"""From a base specification and a grid over its fields to the specifications of all points (Cartesian product)."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

from pydantic import ValidationError

from dualms.errors import DualMSError, InvalidSpec
from dualms.spec import Spec
from dualms.spec.refused import refused

MAX_POINTS = 256
MAX_BYTES = 32 * 1024**2  # of all specifications together, as JSON
PATH = r"^[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z0-9_]+)*$"


class StudyTooLarge(DualMSError):
    """The grid has more points than one study may have."""

    code = "study-too-large"


class InvalidPoint(Exception):
    """A point of the grid is not a specification.

    Parameters
    ----------
    values
        Path to value at that point.
    errors
        Pairs of the field's path, beginning with ``grid.`` or ``spec.``, and what is wrong there.
    """

    def __init__(self, values: Mapping[str, Any], errors: Sequence[tuple[str, str]]) -> None:
        super().__init__(f"{errors[0][0]}: {errors[0][1]}")
        self.values, self.errors = dict(values), tuple(errors)


@dataclass(frozen=True)
class Point:
    """One point of a grid: the value at each path, and the specification that it makes."""

    values: dict[str, Any]
    spec: Spec


def grid_points(base: Mapping[str, Any], grid: Mapping[str, Sequence[Any]]) -> tuple[Point, ...]:
    """All points of a grid, the last path varying fastest.

    Parameters
    ----------
    base
        A specification's document; fields that the grid sets may be missing.
    grid
        Dotted path to the values there, such as ``{"graph.sites": [300, 600], "seed": [0, 1, 2]}``. A number in a path
        is an index into a list, as in ``fluids.hot.inlets.0.radius``.

    Returns
    -------
    tuple of Point
        At most ``MAX_POINTS``.

    Raises
    ------
    StudyTooLarge
        Before anything is made.
    InvalidSpec
        If the grid contradicts itself: no path, no values, a value twice, or a path within another.
    InvalidPoint
        At the first point that is not a specification; an unknown path is one reason.
    """
    _check(base, grid)
    return tuple(
        _point(base, dict(zip(grid, values, strict=True))) for values in itertools.product(*map(list, grid.values()))
    )


def set_path(document: dict[str, Any], path: str, value: Any) -> None:
    """Set a value in a document, making the objects on the way where there are none.

    Raises
    ------
    KeyError
        If the way leads through a value that is no object, or to a list's item that is not there.
    """
    *way, last = path.split(".")
    place: Any = document
    for part in way:
        if isinstance(place, dict) and place.get(part) is None:
            place[part] = {}
        place = place[_key(place, part)]
    place[_key(place, last)] = value


def _key(place: Any, part: str) -> str | int:
    if isinstance(place, dict):
        return part
    if isinstance(place, list) and part.isdecimal() and int(part) < len(place):
        return int(part)
    raise KeyError(part)


def _check(base: Mapping[str, Any], grid: Mapping[str, Sequence[Any]]) -> None:
    if not grid:
        raise InvalidSpec("The grid names no field.", advice='Give paths with values, such as {"seed": [0, 1, 2]}.')
    for path, values in grid.items():
        if re.fullmatch(PATH, path) is None:
            advice = "A path is names with dots between, such as graph.sites."
            raise InvalidSpec(f"grid: '{path[:100]}' is not a path.", advice=advice, measured={"path": path[:100]})
        texts = [json.dumps(value, sort_keys=True) for value in values]
        if not texts or len(set(texts)) < len(texts):
            raise InvalidSpec(
                f"grid.{path} {'lists no values' if not texts else 'lists a value twice'}.",
                advice="List each value once.",
                measured={"path": path},
            )
    for outer, inner in itertools.permutations(grid, 2):
        if inner.startswith(outer + "."):
            raise InvalidSpec(
                f"grid.{inner} lies within grid.{outer}.",
                advice="Vary one of them: the other would be overwritten.",
                measured={"paths": [outer, inner]},
            )
    count = prod(len(values) for values in grid.values())
    advice = "Vary fewer fields or values at once, or send several studies; they share cached steps."
    if count > MAX_POINTS:
        raise StudyTooLarge(
            f"The grid has {count:,} points; a study may have {MAX_POINTS}.",
            advice=advice,
            measured={"points": count, "limit": MAX_POINTS},
        )
    size = count * len(json.dumps(base))
    if size > MAX_BYTES:
        raise StudyTooLarge(
            f"The specifications of {count} points take {size / 2**20:.0f} MiB; a study may take {MAX_BYTES >> 20}.",
            advice=advice,
            measured={"bytes": size, "limit_bytes": MAX_BYTES},
        )


def _point(base: Mapping[str, Any], values: dict[str, Any]) -> Point:
    document = json.loads(json.dumps(base))  # unlike a deep copy, this parts objects that stand in two places
    for path, value in values.items():
        try:
            set_path(document, path, json.loads(json.dumps(value)))
        except KeyError as error:
            reason = f"the specification has no '{error.args[0]}' there"
            raise InvalidPoint(values, [(f"grid.{path}", reason)]) from None
    try:
        return Point(values, Spec.model_validate(document))
    except ValidationError as error:
        found = [(_blame(path, values), message) for path, message in refused(error.errors(), document)[:20]]
        raise InvalidPoint(values, found) from None


def _blame(keys: tuple[str, ...], values: Mapping[str, Any]) -> str:
    """The grid's path that a fault is about, or else the specification's."""
    for path in values:
        rest = iter(keys)
        if all(part in rest for part in path.split(".")):
            return f"grid.{path}"
    return ".".join(("spec", *keys))
