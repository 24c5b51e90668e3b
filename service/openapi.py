"""``python -m service.openapi [FILE]``: write the OpenAPI document that the repository keeps."""

from __future__ import annotations

import json
import sys
from pathlib import Path

DEFAULT = Path(__file__).parents[1] / "openapi" / "openapi.json"


def document() -> str:
    """The document as text, always the same for the same code."""
    from service.app import create_app

    return json.dumps(create_app().openapi(), indent=2, sort_keys=True, ensure_ascii=False) + "\n"


def main() -> None:
    """Write it."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT
    path.parent.mkdir(exist_ok=True)
    path.write_text(document(), encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
