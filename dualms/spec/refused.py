"""What pydantic refuses of a document, at the places where its writer finds it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def refused(errors: Sequence[Mapping[str, Any]], document: object) -> list[tuple[tuple[str, ...], str]]:
    """Keys that lead to each fault, and its message.

    Parameters
    ----------
    errors
        As ``pydantic.ValidationError.errors()`` gives them. Lists that are too short only because their items were
        refused are left out.
    document
        What was validated. What leads nowhere in it is the name of a union's kind in pydantic's words, and no key.
    """
    places = [tuple(error["loc"]) for error in errors]
    return [
        (_keys(place, document, error["type"] == "missing"), str(error["msg"]).removeprefix("Value error, "))
        for error, place in zip(errors, places, strict=True)
        if error["type"] != "too_short" or not any(p != place and p[: len(place)] == place for p in places)
    ]


def _keys(place: tuple[str | int, ...], document: object, missing: bool) -> tuple[str, ...]:
    """The parts of a place that lead on in a document; the last of one that is missing leads nowhere yet."""
    keys: list[str] = []
    at: Any = document
    for k, part in enumerate(place):
        leads = part in at if isinstance(at, Mapping) else isinstance(at, list | tuple) and part in range(len(at))
        if leads:
            at = at[part]
        if leads or (missing and k == len(place) - 1):
            keys.append(str(part))
    return tuple(keys)
