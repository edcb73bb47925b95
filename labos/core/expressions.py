"""Conditions that people write in workflows: ``result.od > 0.1 and payload.kind in ["a", "b"]``.

A small language: comparisons, ``and`` ``or`` ``not``, ``+ - * /``, ``in``, the functions ``abs min max len``,
numbers, texts, lists, and names that refer to values in given tables. No Python code is executed. For any
text and any fault, the only error is ``ExpressionError``.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from labos.errors import BadInput

LONGEST = 1000
"""The most characters of an expression."""

DEEPEST = 24
"""The most levels of brackets and operators."""

LARGEST = 2**63 - 1
"""The largest whole number that an expression may contain: every reader of a log can store it."""

Name = tuple[str | int, ...]
"""``result.od[0]`` as ``("result", "od", 0)``."""

Tree = tuple[Any, ...]
"""An operation and its parts: ``("value", x)``, ``("name", path)``, ``("list", parts)``,
``("call", name, parts)``, ``("not", a)``, ``("minus", a)``, ``("row", signs, parts)`` of one rank,
``("chain", a, ((sign, b), …))``."""


class ExpressionError(BadInput):
    """A condition cannot be parsed or evaluated."""


_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r"|(?P<text>\"[^\"\n]*\"|'[^'\n]*')"
    r"|(?P<word>[A-Za-z_]\w*)"
    r"|(?P<sign><=|>=|==|!=|[-+*/<>()\[\],.]))",
    re.ASCII,
)
_WORDS = ("and", "or", "not", "in")
_VALUES: dict[str, Any] = {
    "true": True, "True": True, "false": False, "False": False, "null": None, "None": None,
}  # fmt: skip
FUNCTIONS = ("abs", "min", "max", "len")
ROOTS = ("result", "payload", "steps")


def parse_expression(text: str) -> Tree:
    """Read an expression. Raises ExpressionError."""
    if len(text) > LONGEST:
        raise ExpressionError(f"The expression has more than {LONGEST} characters.", remedy="Shorten it.")
    return _parse(text)


@lru_cache(maxsize=512)
def _parse(text: str) -> Tree:
    reader = _Reader(text)
    tree = reader.read_choice(0)
    reader.end()
    return tree


def list_names(tree: Tree) -> list[Name]:
    """The names that an expression refers to, each once."""
    return list(dict.fromkeys(_iterate_names(tree)))


def _iterate_names(tree: Tree) -> Iterator[Name]:
    parts: tuple[Tree, ...] = ()
    match tree[0]:
        case "name":
            yield tree[1]
        case "list":
            parts = tree[1]
        case "call" | "row":
            parts = tree[2]
        case "not" | "minus":
            parts = tree[1:]
        case "chain":
            parts = (tree[1], *(part for _, part in tree[2]))
        case _:
            pass
    for part in parts:
        yield from _iterate_names(part)


class _Reader:
    """A recursive descent parser with one token of look-ahead."""

    def __init__(self, text: str) -> None:
        self.text, self.at, self.kind, self.token = text, 0, "", ""
        self._advance()

    def _advance(self) -> None:
        match = _TOKEN.match(self.text, self.at)
        if match is None:
            rest = self.text[self.at :].strip()
            if rest:
                raise self.make_error(f"{rest[:20]!r} is not understood")
            self.kind = self.token = ""
            return
        self.at = match.end()
        self.kind = str(match.lastgroup)
        self.token = match[self.kind]
        if self.kind == "word" and self.token in _WORDS:
            self.kind = "sign"

    def make_error(self, what: str) -> ExpressionError:
        shown = self.text if len(self.text) <= 80 else self.text[:79] + "…"
        return ExpressionError(
            f"The expression {shown!r} cannot be read: {what}.",
            remedy='Write it as `result.value > 0.5 and payload.kind in ["a", "b"]`.',
        )

    def take_sign(self, *signs: str) -> str:
        """The next sign, if it is one of ``signs``; the reader then moves past it. Otherwise empty."""
        if self.kind == "sign" and self.token in signs:
            sign = self.token
            self._advance()
            return sign
        return ""

    def expect(self, sign: str) -> None:
        if not self.take_sign(sign):
            raise self.make_error(
                f"{sign!r} is missing before {self.token!r}" if self.token else f"{sign!r} is missing"
            )

    def end(self) -> None:
        if self.kind:
            raise self.make_error(f"{self.token!r} is where the expression should end")

    def _deepen(self, depth: int) -> int:
        if depth >= DEEPEST:
            raise self.make_error("it is nested too deeply")
        return depth + 1

    def read_choice(self, depth: int) -> Tree:
        depth = self._deepen(depth)
        return self._read_row(lambda: self._read_all(depth), "or")

    def _read_all(self, depth: int) -> Tree:
        return self._read_row(lambda: self._read_negation(depth), "and")

    def _read_row(self, part: Callable[[], Tree], *signs: str) -> Tree:
        parts = [part()]
        found: list[str] = []
        while sign := self.take_sign(*signs):
            found.append(sign)
            parts.append(part())
        return parts[0] if not found else ("row", tuple(found), tuple(parts))

    def _read_negation(self, depth: int) -> Tree:
        if self.take_sign("not"):
            return ("not", self._read_negation(self._deepen(depth)))
        return self._read_comparison(depth)

    def _read_comparison(self, depth: int) -> Tree:
        first = self._read_sum(depth)
        rest: list[tuple[str, Tree]] = []
        while sign := self.take_sign("==", "!=", "<", "<=", ">", ">=", "in", "not"):
            if sign == "not":
                self.expect("in")
                sign = "not in"
            rest.append((sign, self._read_sum(depth)))
        return ("chain", first, tuple(rest)) if rest else first

    def _read_sum(self, depth: int) -> Tree:
        return self._read_row(lambda: self._read_product(depth), "+", "-")

    def _read_product(self, depth: int) -> Tree:
        return self._read_row(lambda: self._read_sign(depth), "*", "/")

    def _read_sign(self, depth: int) -> Tree:
        if self.take_sign("-"):
            return ("minus", self._read_sign(self._deepen(depth)))
        return self._read_atom(depth)

    def _read_atom(self, depth: int) -> Tree:
        kind, token = self.kind, self.token
        if kind == "number":
            self._advance()
            return ("value", self._read_number(token))
        if kind == "text":
            self._advance()
            return ("value", token[1:-1])
        if self.take_sign("("):
            inner = self.read_choice(depth)
            self.expect(")")
            return inner
        if self.take_sign("["):
            return ("list", self._read_parts("]", depth))
        if kind == "word":
            self._advance()
            return self._read_word(token, depth)
        raise self.make_error(
            f"{token!r} is where a value should be" if token else "it ends where a value should be"
        )

    def _read_number(self, token: str) -> int | float:
        number = int(token) if token.isdigit() else float(token)
        if number > LARGEST if isinstance(number, int) else not math.isfinite(number):
            shown = token if len(token) <= 30 else f"{token[:29]}…"
            raise self.make_error(
                f"{shown} is too large; whole numbers have 64 bits, others are below 1.8e308"
            )
        return number

    def _read_parts(self, end: str, depth: int) -> tuple[Tree, ...]:
        parts: list[Tree] = []
        while not self.take_sign(end):
            if parts:
                self.expect(",")
            parts.append(self.read_choice(depth))
        return tuple(parts)

    def _read_word(self, word: str, depth: int) -> Tree:
        if word in _VALUES:
            return ("value", _VALUES[word])
        if self.take_sign("("):
            if word not in FUNCTIONS:
                raise self.make_error(f"there is no function {word!r}; known are {', '.join(FUNCTIONS)}")
            return ("call", word, self._read_parts(")", depth))
        if word not in ROOTS:
            raise self.make_error(
                f"{word!r} is not a name; names begin with {', '.join(ROOTS)}; texts need quotes"
            )
        return ("name", (word, *self._read_fields()))

    def _read_fields(self) -> Iterator[str | int]:
        while sign := self.take_sign(".", "["):
            kind, token = self.kind, self.token
            if kind == "number" and (not token.isdigit() or int(token) > LARGEST):
                raise self.make_error("a place in a list is a whole number, of 64 bits at most")
            if sign == "." and kind != "word" and token not in _WORDS:
                raise self.make_error("a name should follow the point")
            if sign == "[" and kind not in ("number", "text"):
                raise self.make_error("a number or a text in quotes should follow '['")
            self._advance()
            yield int(token) if kind == "number" else token[1:-1] if kind == "text" else token
            if sign == "[":
                self.expect("]")


# -- deciding ----------------------------------------------------------------------------------


def evaluate(tree: Tree, tables: Mapping[str, Any]) -> Any:
    """The value of an expression. ``tables`` holds the values of names, by the first word of the name. Raises
    ExpressionError."""
    try:
        return _evaluate_tree(tree, tables)
    except (OverflowError, RecursionError, ValueError):
        raise ExpressionError("The result of the expression is too large.") from None


def _evaluate_tree(tree: Tree, tables: Mapping[str, Any]) -> Any:
    match tree[0]:
        case "value":
            return tree[1]
        case "name":
            return look_up(tree[1], tables)
        case "list":
            return [_evaluate_tree(part, tables) for part in tree[1]]
        case "call":
            return _call(tree[1], [_evaluate_tree(part, tables) for part in tree[2]])
        case "not":
            return not _expect_truth(_evaluate_tree(tree[1], tables))
        case "minus":
            return -_expect_number(_evaluate_tree(tree[1], tables))
        case "row":
            return _evaluate_row(tree[1], tree[2], tables)
        case _:
            pass
    return _evaluate_chain(tree, tables)


def _evaluate_row(signs: tuple[str, ...], parts: tuple[Tree, ...], tables: Mapping[str, Any]) -> Any:
    if signs[0] in ("and", "or"):
        stop = signs[0] == "or"
        stops = any(_expect_truth(_evaluate_tree(part, tables)) is stop for part in parts)
        return stop if stops else not stop
    found = _expect_number(_evaluate_tree(parts[0], tables))
    for sign, part in zip(signs, parts[1:], strict=True):
        right = _expect_number(_evaluate_tree(part, tables))
        if sign == "/" and right == 0:
            raise ExpressionError("The expression divides by zero.")
        found = _ARITHMETIC[sign](found, right)
        if not math.isfinite(found):
            raise OverflowError
    return found


_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
}  # fmt: skip
_ORDER: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip


def _evaluate_chain(tree: Tree, tables: Mapping[str, Any]) -> bool:
    left = _evaluate_tree(tree[1], tables)
    for sign, part in tree[2]:
        right = _evaluate_tree(part, tables)
        if not _compare(sign, left, right):
            return False
        left = right
    return True


def _compare(sign: str, left: Any, right: Any) -> bool:
    if sign in ("==", "!="):
        return _is_same(left, right) == (sign == "==")
    if sign in ("in", "not in"):
        if isinstance(right, str) and isinstance(left, str):
            found = left in right
        elif isinstance(right, list | tuple):
            found = any(_is_same(left, item) for item in right)
        elif isinstance(right, Mapping):
            found = isinstance(left, str) and left in right
        else:
            raise ExpressionError(
                f"{_show(right)} is neither a list nor a text, so `in` is not possible.",
                remedy="Name a list or a text.",
            )
        return found == (sign == "in")
    if isinstance(left, str) and isinstance(right, str):
        return _ORDER[sign](left, right)
    return _ORDER[sign](_expect_number(left), _expect_number(right))


def _is_same(left: Any, right: Any) -> bool:
    """Whether two values are equal; true is not equal to 1."""
    return isinstance(left, bool) == isinstance(right, bool) and bool(left == right)


def look_up(name: Name, tables: Mapping[str, Any]) -> Any:
    """The value of a name. Raises ExpressionError."""
    found: Any = tables
    for number, part in enumerate(name):
        try:
            if isinstance(found, list | tuple):
                found = found[part if isinstance(part, int) else int(part)]
            elif isinstance(found, Mapping):
                found = found[part if part in found else str(part)]
            else:
                raise KeyError(part)
        except (KeyError, IndexError, ValueError, TypeError):
            where = ".".join(map(str, name[:number])) or "the expression"
            raise ExpressionError(f"There is no {part!r} in {where}.", remedy="Correct the name.") from None
    return found


def _call(name: str, parts: list[Any]) -> Any:
    if name == "len":
        if len(parts) != 1 or not isinstance(parts[0], str | list | tuple | Mapping):
            raise ExpressionError("`len` takes one list, table or text.")
        return len(parts[0])
    if name == "abs":
        if len(parts) != 1:
            raise ExpressionError("`abs` takes one number.")
        return abs(_expect_number(parts[0]))
    many = parts[0] if len(parts) == 1 and isinstance(parts[0], list | tuple) else parts
    if not many:
        raise ExpressionError(f"`{name}` takes at least one number.")
    numbers = [_expect_number(part) for part in many]
    return min(numbers) if name == "min" else max(numbers)


def _expect_number(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return value
    raise ExpressionError(
        f"{_show(value)} is not a number.", remedy="Correct the name, or quote a text on both sides."
    )


def _expect_truth(value: Any) -> bool:
    if isinstance(value, bool):
        return value
    raise ExpressionError(f"{_show(value)} is neither true nor false.", remedy="Compare it with something.")


def _show(value: Any) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**30 else "a very large number"
    return text if len(text) <= 40 else f"{text[:39]}…"
