"""What pydantic refuses of a document, in the words of whoever wrote it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def refused(errors: Sequence[Mapping[str, Any]]) -> list[tuple[tuple[str, ...], str]]:
    """Path and message of each fault.

    Parameters
    ----------
    errors
        As ``pydantic.ValidationError.errors()`` gives them. Names of the kinds of a union, which are no keys of the
        document, are left out, and so are lists that are too short only because their items were refused.
    """
    places = [tuple(error["loc"]) for error in errors]
    return [
        (_keys(place), str(error["msg"]).removeprefix("Value error, "))
        for error, place in zip(errors, places, strict=True)
        if error["type"] != "too_short" or not any(p != place and p[: len(place)] == place for p in places)
    ]


def _keys(location: tuple[str | int, ...]) -> tuple[str, ...]:
    parts = (str(part) for part in location)
    return tuple(p for p in parts if not (p[:1].isupper() or "[" in p or "(" in p))
