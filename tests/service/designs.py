"""What tests of designs share: a small one, its files, its event stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from conftest import Served


def small(**changes: Any) -> dict[str, Any]:
    """A small design in the box, the same for all files: what one has designed, the others find in the cache."""

    def disk(x: float, y: float) -> dict[str, Any]:
        return {"center": [x, y, 0], "radius": 5}

    return {
        "fluids": {
            "hot": {"inlets": [disk(-20, -7)], "outlets": [disk(20, -7)]},
            "cold": {"inlets": [disk(20, 7)], "outlets": [disk(-20, 7)]},
        },
        "graph": {"sites": 32},
        "partition": {"method": "anneal", "seconds": 0.1},
        "field": {"method": "phase-field", "resolution": 40},
        "surface": {"resolution": 48},
        "pictures": {"width": 160},
        "wall": {"thickness": 1.0},
        **changes,
    }


def artifact(made: dict[str, Any], name: str) -> dict[str, Any]:
    return next(a for a in made["artifacts"] if a["name"] == name)


def read_stream(served: Served, href: str, last: str | None = None) -> list[dict[str, str]]:
    headers = {"Last-Event-ID": last} if last else {}
    events: list[dict[str, str]] = []
    with served.http.stream("GET", href, headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        block: dict[str, str] = {}
        for line in answer.iter_lines():
            if line and not line.startswith(":"):
                name, _, value = line.partition(": ")
                block[name] = value
            elif block:
                events.append(block)
                block = {}
    return events
