"""The page /docs: the OpenAPI document for people, made here, so that it needs no other host."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment
from markupsafe import Markup, escape

Json = dict[str, Any]


@cache
def reference_page(document: str) -> str:
    """The page for an OpenAPI document."""
    api: Json = json.loads(document)
    groups: dict[str, list[Json]] = {}
    for path, item in api["paths"].items():
        for method, call in item.items():
            groups.setdefault(call["tags"][0], []).append(_call(path, method.upper(), call))
    values = [_value(name, schema) for name, schema in sorted(api["components"]["schemas"].items())]
    text = (Path(__file__).parent / "web" / "reference.html").read_text(encoding="utf-8")
    return str(Environment(autoescape=True).from_string(text).render(api=api, groups=groups, values=values))


def _call(path: str, method: str, call: Json) -> Json:
    parameters = [
        {"name": p["name"], "where": p["in"], "required": p.get("required", False), "type": _type(p["schema"]),
         "text": _prose(p.get("description", ""))}
        for p in call.get("parameters", [])
    ]  # fmt: skip
    bodies = [
        {"media": media, "type": _type(content["schema"]), "rows": _rows(content["schema"])}
        for media, content in call.get("requestBody", {}).get("content", {}).items()
    ]
    answers = [
        {"status": status, "text": _prose(answer["description"]), "type": _types(answer.get("content", {}))}
        for status, answer in sorted(call["responses"].items())
    ]
    text = _prose(str(call.get("description", call.get("summary", ""))))
    return {"id": call["operationId"], "path": path, "method": method, "text": text, "parameters": parameters,
            "bodies": bodies, "answers": answers}  # fmt: skip


def _value(name: str, schema: Json) -> Json:
    choices = Markup(" · ").join(Markup("<code>{}</code>").format(c) for c in schema.get("enum", []))
    return {"name": name, "text": _prose(schema.get("description", "")), "choices": choices, "rows": _rows(schema)}


def _rows(schema: Json) -> list[Json]:
    required = schema.get("required", [])
    return [
        {
            "name": name,
            "type": _type(field),
            "required": name in required,
            "default": json.dumps(field["default"]) if "default" in field else None,
            "text": _prose(field.get("description", "")),
        }
        for name, field in schema.get("properties", {}).items()
    ]


def _prose(text: str) -> Markup:
    """A description, with what stands in backticks as code."""
    pieces = re.split(r"`+", text)
    return Markup("").join(
        Markup("<code>{}</code>").format(piece) if i % 2 else escape(piece) for i, piece in enumerate(pieces)
    )


def _types(content: Json) -> Markup:
    return Markup(", ").join(
        _type(c["schema"]) if c.get("schema") else Markup("<code>{}</code>").format(media)
        for media, c in content.items()
    )


def _type(schema: Json) -> Markup:
    """A schema in a few words, with links to named ones."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return Markup('<a href="#{0}">{0}</a>').format(name)
    for union in ("anyOf", "oneOf"):
        if union in schema:
            return Markup(" or ").join(_type(s) for s in schema[union])
    if "const" in schema:
        return Markup("<code>{}</code>").format(json.dumps(schema["const"]))
    if "enum" in schema:
        return Markup(" or ").join(Markup("<code>{}</code>").format(json.dumps(e)) for e in schema["enum"])
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return Markup("[{}]").format(Markup(", ").join(_type(s) for s in schema["prefixItems"]))
        return Markup("list of {}").format(_type(schema.get("items", {})))
    bounds = [f"{sign} {schema[key]:g}" for key, sign in _BOUNDS.items() if key in schema]
    return escape(" ".join([schema.get("format") or schema.get("type", "anything"), *bounds]))


_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
