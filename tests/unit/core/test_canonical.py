"""One value, one sequence of bytes; and no number that JSON cannot spell."""

from __future__ import annotations

import json
import math
from collections import OrderedDict, defaultdict
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labos.core.canonical import digest, encode_canonical, refuse_non_finite

JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


class Pair(msgspec.Struct):
    b: Any
    a: Any


@given(JSON)
@settings(max_examples=100, derandomize=True, deadline=None)
def test_it_is_json_and_reads_back(value: Any) -> None:
    assert msgspec.json.decode(encode_canonical(value)) == value
    assert json.loads(encode_canonical(value)) == value


def test_keys_are_sorted_at_every_depth_and_there_is_no_white_space() -> None:
    assert encode_canonical({"b": {"d": 1, "c": [{"z": 0, "y": 1}]}, "a": 2}) == (
        b'{"a":2,"b":{"c":[{"y":1,"z":0}],"d":1}}'
    )
    assert encode_canonical(Pair(b=1, a=2)) == b'{"a":2,"b":1}'


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "wrap",
    [
        lambda x: x,
        lambda x: [1, [x]],
        lambda x: {"a": {"b": x}},
        lambda x: ({"a": (1.0, x)},),
        lambda x: Pair(1, {"deep": [x]}),
        lambda x: OrderedDict(a=x),
        lambda x: defaultdict(float, a=[x]),
        lambda x: {"a": frozenset([x])},
        lambda x: {x},
    ],
)
def test_what_is_not_finite_is_refused_anywhere(bad: float, wrap: Any) -> None:
    with pytest.raises(ValueError, match="is not a finite number"):
        encode_canonical(wrap(bad))


def test_a_key_that_is_no_string_is_refused() -> None:
    with pytest.raises(TypeError):
        encode_canonical({math.nan: 1})


def test_digest_is_sha_256() -> None:
    assert digest(b"") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


def nest(levels: int, kind: type = list) -> Any:
    value: Any = 1
    for _ in range(levels):
        value = [value] if kind is list else {"a": value}
    return value


@pytest.mark.parametrize("kind", [list, dict])
@pytest.mark.parametrize("levels", [101, 900, 5000, 100_000])
def test_what_stands_too_deep_is_refused(kind: type, levels: int) -> None:
    with pytest.raises(ValueError, match="Lists and objects are nested more than 100 levels deep"):
        encode_canonical(nest(levels, kind))


def test_a_hundred_levels_are_kept_and_brackets_in_texts_are_none() -> None:
    assert msgspec.json.decode(encode_canonical(nest(100))) == nest(100)
    text = {'[{"\\': ['[[[["{{{{\\"', "[" * 500, "\\"]}
    assert msgspec.json.decode(encode_canonical(text)) == text


@pytest.mark.parametrize("bad", [2**64, 2**70, -(2**63) - 1, 10**400])
def test_a_whole_number_beyond_64_bits_is_refused(bad: int) -> None:
    for value in (bad, [bad], {"a": {"b": bad}}, Pair(1, [bad])):
        with pytest.raises(ValueError, match="does not fit into 64 bits"):
            encode_canonical(value)


@pytest.mark.parametrize("bad", ["\ud800", "plate \udfff", {"\ud800": 1}, ["x", {"a": "\udc80"}]])
def test_text_without_utf_8_is_refused(bad: Any) -> None:
    with pytest.raises(ValueError, match="half a surrogate pair"):
        encode_canonical(bad)


def test_what_is_not_finite_is_found_at_any_depth() -> None:
    refuse_non_finite(nest(100_000))
