"""Computes values of expressions in a Python protocol, as far as this is possible without running it.

Only literals, plain arithmetic and a few functions of Python are computed; everything else is ``UNKNOWN``.
A list can contain unknown items and still have a known length.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator
from typing import Any, Final

LONGEST = 10_000
"""Items of a list, characters of a text and digits of a number beyond which nothing is worked out."""


class Unknown:
    """A value that cannot be determined without running the protocol."""

    def __repr__(self) -> str:
        return "unknown"


UNKNOWN: Final = Unknown()

LENGTHS: dict[str, Callable[..., Any]] = {
    "len": len,
    "list": list,
    "tuple": tuple,
    "enumerate": lambda *args: list(enumerate(*args)),
    "zip": lambda *args: list(zip(*args, strict=False)),
    "reversed": lambda items: list(reversed(items)),
}
"""Functions that only arrange items, whatever these are."""
PLAIN: dict[str, Callable[..., Any]] = {
    "range": range,
    "int": int,
    "float": float,
    "str": str,
    "bool": bool,
    "abs": abs,
    "round": round,
    "min": min,
    "max": max,
    "sum": sum,
    "sorted": sorted,
}
BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda item, items: item in items,
    ast.NotIn: lambda item, items: item not in items,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
}


def is_known(value: Any) -> bool:
    """Whether a value and all its parts are known: text, numbers, ranges, None, or containers of them."""
    return all(_is_plain(part) for part in parts_of(value) if not isinstance(part, list | tuple | dict))


def is_flat(value: Any) -> bool:
    """Whether a value is known and not a list of lists; a search of such a list could take too long."""
    items = (
        value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else [value]
    )
    return all(map(_is_plain, items))


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float | range)


def parts_of(value: Any) -> Iterator[Any]:
    """A value and everything that it contains. Each list, tuple and dict is searched only once."""
    open_, seen = [value], set()
    while open_:
        here = open_.pop()
        yield here
        if isinstance(here, list | tuple | dict) and id(here) not in seen:
            seen.add(id(here))
            open_ += here.values() if isinstance(here, dict) else here


def limit_size(value: Any) -> Any:
    """The value, or UNKNOWN if it is too large for further computation."""
    too_long = isinstance(value, str | list | tuple | dict) and len(value) > LONGEST
    too_great = isinstance(value, int) and value.bit_length() > LONGEST
    return UNKNOWN if too_long or too_great else value


def apply(function: Callable[..., Any], *args: Any) -> Any:
    """The result of a function; UNKNOWN if it raises an error or the result is too large."""
    try:
        return limit_size(function(*args))
    except (TypeError, ValueError, ArithmeticError, LookupError):
        return UNKNOWN


def combine(kind: type[ast.operator], left: Any, right: Any) -> Any:
    """The result of a binary operation; UNKNOWN if it cannot be computed."""
    function = BINARY.get(kind)
    if kind is ast.Add and isinstance(left, list) and isinstance(right, list):
        return apply(operator.add, left, right)
    if kind is ast.Mult and isinstance(left, list | tuple | str) and isinstance(right, int):
        return apply(operator.mul, left, right) if len(left) * max(right, 0) <= LONGEST else UNKNOWN
    if function is None or not (_is_number(left) and _is_number(right)):
        both_text = isinstance(left, str) and isinstance(right, str) and kind is ast.Add
        return apply(operator.add, left, right) if both_text else UNKNOWN
    return apply(function, left, right)


def call_builtin(name: str, args: list[Any]) -> Any:
    """The result of a built-in function of Python; UNKNOWN if it cannot be computed."""
    if any(isinstance(arg, range) and len(arg) > LONGEST for arg in args):
        return UNKNOWN
    if name in LENGTHS and not any(arg is UNKNOWN for arg in args):
        return apply(LENGTHS[name], *args)
    if name in PLAIN and all(map(is_flat, args)):
        return apply(PLAIN[name], *args)
    return UNKNOWN


def item_of(held: Any, key: Any) -> Any:
    """The item ``held[key]``; UNKNOWN if it cannot be determined."""
    if not isinstance(held, list | tuple | dict | str | range) or not (
        is_known(key) or isinstance(key, slice)
    ):
        return UNKNOWN
    return apply(operator.getitem, held, key)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float)
