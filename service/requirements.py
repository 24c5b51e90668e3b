"""Requirements on a report, such as ``fluids.hot.components == 1 and solid_volume_fraction < 0.2``.

A small language for CI: names with dots reach into the report's JSON, numbers, strings, true/false/none, arithmetic,
comparisons, and/or/not, abs/min/max/len, and indices into lists. Nothing else is parsed, so nothing else can run.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

MAX_LENGTH = 2000

_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_COMPARE: dict[type, Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_UNARY: dict[type, Callable[[Any], Any]] = {ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: operator.not_}
_FUNCTIONS: dict[str, Callable[..., Any]] = {"abs": abs, "min": min, "max": max, "len": len}
_CONSTANTS: dict[str, object] = {"true": True, "false": False, "none": None, "null": None}


class BadRequirement(ValueError):
    """The expression is not one of the language, or does not fit the report."""


@dataclass(frozen=True)
class Verdict:
    """What came of one requirement.

    Parameters
    ----------
    expression
        As it was given.
    met
        Whether it holds.
    values
        Every figure of the report that it names, with its value there.
    """

    expression: str
    met: bool
    values: Mapping[str, object]

    def __str__(self) -> str:
        facts = ", ".join(f"{k} = {v!r}" for k, v in self.values.items())
        return f"{'met' if self.met else 'NOT met'}: {self.expression}" + (f"   ({facts})" if facts else "")


def parse(expression: str) -> ast.expr:
    """Read an expression.

    Raises
    ------
    BadRequirement
        If it is longer than 2,000 characters or not of the language.
    """
    if len(expression) > MAX_LENGTH:
        raise BadRequirement(f"the requirement has {len(expression)} characters; the limit is {MAX_LENGTH}")
    try:
        body = ast.parse(expression, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise BadRequirement(f"'{expression}' is not an expression: {getattr(error, 'msg', error)}") from None
    _check(body, expression)
    return body


def check(expression: str, report: Mapping[str, object]) -> Verdict:
    """Decide whether a report meets a requirement.

    Raises
    ------
    BadRequirement
        If the expression is not of the language, names a figure that the report lacks, or compares what cannot be.
    """
    values: dict[str, object] = {}
    try:
        result = _evaluate(parse(expression), report, values)
    except (TypeError, ZeroDivisionError, IndexError, ValueError, RecursionError) as error:
        if isinstance(error, BadRequirement):
            raise
        raise BadRequirement(f"'{expression}' cannot be decided: {error}") from None
    if not isinstance(result, bool):
        raise BadRequirement(f"'{expression}' gives {result!r}; a requirement must be true or false")
    return Verdict(expression, result, values)


def _check(node: ast.expr, expression: str) -> None:
    match node:
        case ast.Constant(value=bool() | int() | float() | str()) | ast.Name() | ast.Attribute():
            if not isinstance(node, ast.Constant):
                _dotted(node, expression)
        case ast.BoolOp():
            for value in node.values:
                _check(value, expression)
        case ast.UnaryOp() if type(node.op) in _UNARY:
            _check(node.operand, expression)
        case ast.BinOp() if type(node.op) in _BINARY:
            _check(node.left, expression)
            _check(node.right, expression)
        case ast.Compare() if all(type(op) in _COMPARE for op in node.ops):
            for side in (node.left, *node.comparators):
                _check(side, expression)
        case ast.Call(func=ast.Name(id=name), keywords=[]) if name in _FUNCTIONS:
            for argument in node.args:
                _check(argument, expression)
        case ast.List() | ast.Tuple():
            for element in node.elts:
                _check(element, expression)
        case ast.Subscript(slice=ast.Constant(value=int() | str())):
            _check(node.value, expression)
        case _:
            part = ast.get_source_segment(expression, node) or type(node).__name__
            raise BadRequirement(
                f"'{part}' is not allowed in a requirement; use the report's figures, numbers, comparisons, "
                "and/or/not, + - * /, abs, min, max, len"
            )


def _dotted(node: ast.expr, expression: str) -> str:
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=value, attr=attribute):
            return f"{_dotted(value, expression)}.{attribute}"
        case _:
            raise BadRequirement(
                f"'{expression}': a figure is named by words with dots between, such as wall.thickness_m"
            )


def _evaluate(node: ast.expr, report: Mapping[str, object], values: dict[str, object]) -> Any:
    match node:
        case ast.Constant():
            return node.value
        case ast.Name() | ast.Attribute():
            name = _dotted(node, "")
            return _CONSTANTS[name] if name in _CONSTANTS else _figure(name, report, values)
        case ast.BoolOp():
            decide = all if isinstance(node.op, ast.And) else any
            return decide(_evaluate(value, report, values) for value in node.values)
        case ast.UnaryOp():
            return _UNARY[type(node.op)](_evaluate(node.operand, report, values))
        case ast.BinOp():
            left, right = (_number(_evaluate(side, report, values)) for side in (node.left, node.right))
            return _BINARY[type(node.op)](left, right)
        case ast.Compare():
            sides = [_evaluate(side, report, values) for side in (node.left, *node.comparators)]
            pairs = zip(node.ops, sides[:-1], sides[1:], strict=True)
            return all(_COMPARE[type(op)](a, b) for op, a, b in pairs)
        case ast.Call(func=ast.Name(id=name)):
            return _FUNCTIONS[name](*(_evaluate(argument, report, values) for argument in node.args))
        case ast.List() | ast.Tuple():
            return [_evaluate(element, report, values) for element in node.elts]
        case ast.Subscript(slice=ast.Constant(value=key)):
            try:
                return _evaluate(node.value, report, values)[key]
            except KeyError:
                raise BadRequirement(f"the report has no entry {key!r} there") from None
        case _:  # pragma: no cover - parse() let it through
            raise BadRequirement(f"{type(node).__name__} is not of the language")


def _number(value: object) -> float | int:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadRequirement(f"{value!r} is not a number")
    return value


def _figure(name: str, report: Mapping[str, object], values: dict[str, object]) -> object:
    here: object = report
    for i, part in enumerate(name.split(".")):
        if not isinstance(here, Mapping) or part not in here:
            at = ".".join(name.split(".")[:i]) or "the report"
            known = ", ".join(sorted(map(str, here))) if isinstance(here, Mapping) else "no parts"
            raise BadRequirement(f"the report has no figure '{name}': {at} has {known}")
        here = here[part]
    values[name] = here
    return here
