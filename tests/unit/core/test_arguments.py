"""What a value may be is judged alike by whoever reads a file and by the node that gets it."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labos.core.arguments import describe_arg, find_flaw, list_names
from labos.core.model import ActionSpec, Arg
from labos.node.arguments import list_problems
from labos.spec.arguments import bind

TIME = Arg("time", "float", unit="s", minimum=0.5, maximum=9.9, aliases=("seconds",))


@pytest.mark.parametrize(
    ("arg", "value", "told"),
    [
        (TIME, 3, ""),
        (TIME, 9.9, ""),
        (TIME, "3", "must be a number, not '3'"),
        (TIME, True, "must be a number, not True"),
        (TIME, 0.1, "is 0.1 s, less than 0.5 s"),
        (TIME, 10, "is 10 s, more than 9.9 s"),
        (TIME, float("inf"), "must be finite, not inf"),
        (Arg("stacker", "int", unit="1", minimum=1, maximum=3), 99, "is 99, more than 3"),
        (Arg("n", "int"), 1.0, "must be a whole number, not 1.0"),
        (Arg("n", "int", required=False), None, ""),
        (Arg("n", "int", required=False, default=1), None, "must be a whole number, not None"),
        (Arg("grip", "str", choices=("narrow", "wide")), "tall", "cannot be 'tall'"),
        (Arg("any"), {"a": 1}, ""),
    ],
)
def test_what_is_wrong_with_a_value(arg: Arg, value: Any, told: str) -> None:
    assert find_flaw(arg, value) == told


def test_what_an_argument_takes_is_said_in_words() -> None:
    assert describe_arg(TIME) == "a number from 0.5 to 9.9 s"
    assert describe_arg(Arg("t", "int", unit="°C")) == "a whole number in °C"
    assert describe_arg(Arg("t", "int", minimum=1)) == "a whole number of at least 1"
    assert describe_arg(Arg("t", "int", maximum=1, unit="s")) == "a whole number of at most 1 s"
    assert describe_arg(Arg("g", "str", choices=("a", 1))) == "one of 'a', 1"
    assert list_names(ActionSpec("seal", args=(TIME,))) == {"time": TIME, "seconds": TIME}


ARGS = st.builds(
    Arg,
    name=st.just("x"),
    type=st.sampled_from(["str", "int", "float", "bool", "list", "dict", "any", "station", "file"]),
    required=st.just(True),
    minimum=st.none() | st.integers(-3, 0),
    maximum=st.none() | st.integers(1, 3),
    unit=st.sampled_from(["", "s"]),
)
VALUES = (
    st.none()
    | st.booleans()
    | st.integers(-5, 5)
    | st.floats(-5, 5)
    | st.sampled_from(["", "a", "2", "2 min", "1 s"])
    | st.lists(st.integers(0, 1), max_size=2)
    | st.dictionaries(st.just("k"), st.integers(), max_size=1)
)


@given(ARGS, VALUES)
def test_what_a_file_may_say_a_node_accepts(arg: Arg, value: Any) -> None:
    spec, faults = ActionSpec("act", args=(arg,)), []
    bound = bind(spec, {"x": value}, lambda name, message, remedy: faults.append(message))
    if not faults:
        assert list_problems(spec, bound) == []


def test_a_mere_number_has_no_unit_in_messages() -> None:
    stacker = Arg("stacker", "int", unit="1", minimum=1, maximum=3)
    assert describe_arg(stacker) == "a whole number from 1 to 3"
    assert describe_arg(Arg("n", "int", unit="1")) == "a whole number"
    faults: list[str] = []
    bind(ActionSpec("a", args=(stacker,)), {"stacker": "2 mm"}, lambda *fault: faults.append(" ".join(fault)))
    assert "has no unit, not in 'mm'" in faults[0]
    assert "from 1 to 3 for" in faults[0]
