"""Conditions: what they mean, and that nothing but their own error comes out of any text."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labos.core.conditions import find_decision, find_reads, holds, make_condition
from labos.core.expressions import (
    DEEPEST,
    LONGEST,
    ExpressionError,
    evaluate,
    list_names,
    parse_expression,
)

TABLES: dict[str, Any] = {
    "result": {"od": 0.5, "wells": [1, 2, 3], "name": "plate 7", "ok": True, "none": None},
    "payload": {"limit": 1, "kinds": ["a", "b"], "odd name": 4, "deep": {"x": {"y": -2}}},
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3 - 4 / 2", 5.0),
        ("-(1 + 2)", -3),
        ("2 - 1 - 1", 0),
        ("8 / 4 / 2", 1.0),
        ("result.od < payload.limit", True),
        ("0 < result.od <= 0.5", True),
        ("0 < result.od < 0.5", False),
        ("not result.ok or result.od == 0.5", True),
        ("not (result.ok and true)", False),
        ('"a" in payload.kinds and "c" not in payload.kinds', True),
        ("'late 7' in result.name or 'plate' in result.name", True),
        ('payload["odd name"] == 4', True),
        ("result.wells[2] + payload.deep.x.y", 1),
        ("len(result.wells) == 3 and len('ab') == 2", True),
        ("max(result.wells) - min(1, 5)", 2),
        ("abs(payload.deep.x.y)", 2),
        ("true == 1", False),
        ("result.none == null", True),
        ("[1, 'a'] == [1, 'a']", True),
        ('"b" > "a"', True),
        (".5e1", 5.0),
        ("false and result.nothing == 1", False),
    ],
)
def test_what_an_expression_means(text: str, value: Any) -> None:
    found = evaluate(parse_expression(text), TABLES)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "it ends where a value should be"),
        ("1 +", "it ends where"),
        ("1 2", "'2' is where the expression should end"),
        ("result.od > > 1", "'>' is where a value should be"),
        ("open('x')", "there is no function 'open'"),
        ("od > 1", "'od' is not a name"),
        ("result.__class__.__mro__ == 1", "There is no '__class__' in result"),
        ("payload.limit(1)", "'(' is where the expression should end"),
        ("result.od = 1", "'= 1' is not understood"),
        ("1 / 0", "divides by zero"),
        ("1 and true", "1 is neither true nor false"),
        ("result.name > 1", "'plate 7' is not a number"),
        ("1 in 5", "5 is neither a list nor a text"),
        ("len(1)", "`len` takes one"),
        ("max([])", "at least one number"),
        ("result.wells[9] == 1", "There is no 9 in result.wells"),
        ("(" * 100 + "1" + ")" * 100, "nested too deeply"),
        ("not " * 200 + "true", "nested too deeply"),
        ("1" * (LONGEST + 1), f"more than {LONGEST} characters"),
        ("1e300 * 1e300", "too large"),
        ("1e309 > 1", "1e309 is too large"),
        (f"result.od > {2**63}", f"{2**63} is too large; whole numbers have 64 bits"),
        ("result.od > " + "9" * 900, "is too large"),
        (f"result.wells[{2**63}] > 1", "a place in a list is a whole number, of 64 bits at most"),
        (f"result.wells[{2**63 - 1}] > 1", "There is no 9223372036854775807"),
        (f"{2**63 - 1} * " * 17 + "1 > 0", "too large"),
        ("lambda: 1", "': 1' is not understood"),
    ],
)
def test_what_it_refuses(text: str, why: str) -> None:
    with pytest.raises(ExpressionError) as error:
        evaluate(parse_expression(text), TABLES)
    assert why in str(error.value)


def test_names_are_found_wherever_they_stand() -> None:
    text = 'not (result.a in [payload.b, -steps["Take picture"].result.c]) and max(1, result.d[0]) < 2'
    assert list_names(parse_expression(text)) == [
        ("result", "a"), ("payload", "b"), ("steps", "Take picture", "result", "c"), ("result", "d", 0)
    ]  # fmt: skip


WORDS = st.sampled_from(
    [
        *"[](),+-*/<=01;é",
        *(
            "result",
            "payload",
            "steps",
            ".",
            ".a",
            "<=",
            "==",
            "!=",
            "in",
            "not",
            "and",
            "or",
            "true",
            "null",
        ),
        *("null", "2.5", "1e308", "'x'", '"y"', "len(", "abs(", "max(", "min(", "result.od", "[0]", "**"),
    ]
)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


HUGE = st.sampled_from(
    [str(2**63 - 1), str(2**63), str(2**64), "9" * 400, "1e308", "1e-400", "0" * 50, "1" * 19 + ".5"]
)
ROOT = st.sampled_from(["result.od", "payload", "steps.Read.result.od[0]", "payload.a", "'text'", "null"])


def _nest(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    two = st.tuples(inner, st.sampled_from([*"+-*/<>", "==", "in", "not in", "and", "or"]), inner)
    return (
        two.map(" ".join)
        | inner.map("({})".format)
        | inner.map("not ({})".format)
        | inner.map("-{}".format)
        | inner.map("[{}]".format)
        | st.tuples(st.sampled_from(["abs", "max", "len"]), inner).map("{0[0]}({0[1]})".format)
    )


@given(st.recursive(HUGE | ROOT | st.integers(0, 2**70).map(str), _nest, max_leaves=25), VALUES)
@settings(max_examples=600, deadline=None, derandomize=True)
def test_what_is_read_can_be_recorded_and_decided(text: str, value: Any) -> None:
    with contextlib.suppress(ExpressionError):
        kept = make_condition(text, parse_expression(text))
        find_reads(kept)
        find_decision(kept)
        holds(kept, {"Read": {"result": value}}, value)


def test_brackets_in_brackets_are_refused_before_they_are_recorded() -> None:
    text = "1"
    for _ in range(20):
        text = f"1 * (0 + {text} < 2 and true or false)"
    with pytest.raises(ExpressionError, match="fewer brackets"):
        make_condition(text, parse_expression(text))


@given(st.lists(WORDS, max_size=30).map(" ".join) | st.text(max_size=60), VALUES)
@settings(max_examples=400, deadline=None, derandomize=True)
def test_no_text_raises_anything_else(text: str, value: Any) -> None:
    with contextlib.suppress(ExpressionError):
        tree = parse_expression(text)
        list_names(tree)
        evaluate(tree, {**TABLES, "payload": value})


def test_depth_is_bounded_but_length_is_free() -> None:
    fits = DEEPEST - 2
    assert evaluate(parse_expression("(" * fits + "1" + ")" * fits), {}) == 1
    assert evaluate(parse_expression(" + ".join("1" * 200)), {}) == 200
