"""Conditions of a plan: expressions about results, evaluated while the run is under way."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from labos.core.canonical import encode_canonical
from labos.core.expressions import ExpressionError, Tree, evaluate, list_names
from labos.core.model import Condition, Plan

_OPPOSITE = {"!=": "==", ">=": "<", ">": "<=", "not in": "in"}


def make_condition(text: str, tree: Tree) -> Condition:
    """An expression as a plan stores it. Raises ExpressionError for an expression that cannot be recorded:
    too many brackets, or values of a payload that are too large."""
    try:
        return Condition(text, encode_canonical(tree).decode())
    except ValueError as error:
        shown = text if len(text) <= 80 else f"{text[:79]}…"
        raise ExpressionError(
            f"The expression {shown!r} cannot be stored:  {error}", remedy="Write it with fewer brackets."
        ) from None


@lru_cache(maxsize=1024)
def _read(tree: str) -> Tree:
    found: Tree = _as_tree(json.loads(tree))
    return found


def _as_tree(found: Any) -> Any:
    if not isinstance(found, list):
        return found
    if found and found[0] == "value":
        return ("value", found[1])
    return tuple(_as_tree(part) for part in found)


def holds(condition: Condition, results: Mapping[str, Any], result: Any = None) -> bool:
    """Whether a condition holds. ``results`` are those of earlier steps by key, ``result`` the step's own.
    Raises ExpressionError."""
    found = evaluate(_read(condition.tree), {"steps": results, "result": result})
    if not isinstance(found, bool):
        raise ExpressionError("It is neither true nor false.", remedy="Compare the value with something.")
    return found


def sort_results_by_key(plan: Plan, results: Mapping[int, Any]) -> dict[str, Any]:
    """The results by the keys of their steps; ``results`` has them by the steps' indexes."""
    return {plan.steps[index].key: result for index, result in results.items()}


def find_reads(condition: Condition) -> set[str]:
    """The keys of the steps whose results a condition reads."""
    return {
        str(name[1]) for name in list_names(_read(condition.tree)) if name[0] == "steps" and len(name) > 1
    }


def find_decision(condition: Condition) -> tuple[str, bool]:
    """The text that a condition decides, and the value that makes the condition true. ``x > 1``, ``not (x >
    1)`` and ``x <= 1`` decide the same."""
    tree, positive = _read(condition.tree), True
    while tree[0] == "not":
        tree, positive = tree[1], not positive
    if tree[0] == "chain" and len(tree[2]) == 1 and tree[2][0][0] in _OPPOSITE:
        sign, part = tree[2][0]
        tree, positive = ("chain", tree[1], ((_OPPOSITE[sign], part),)), not positive
    return encode_canonical(tree).decode(), positive


def fill_in(tree: Tree, values: Mapping[tuple[Any, ...], Tree]) -> Tree:
    """An expression in which names are replaced."""
    match tree[0]:
        case "name":
            return values.get(tree[1], tree)
        case "list":
            return ("list", tuple(fill_in(part, values) for part in tree[1]))
        case "call" | "row":
            return (tree[0], tree[1], tuple(fill_in(part, values) for part in tree[2]))
        case "not" | "minus":
            return (tree[0], fill_in(tree[1], values))
        case "chain":
            rest = tuple((sign, fill_in(part, values)) for sign, part in tree[2])
            return ("chain", fill_in(tree[1], values), rest)
        case _:
            pass
    return tree
