"""Arguments against their declaration."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.model import ActionSpec, Arg
from labos.errors import ActionInvalid
from labos.node.arguments import ArgumentProblem, bind, list_problems

SEAL = ActionSpec(
    "seal",
    args=(
        Arg("time", "float", unit="s", minimum=0.5, maximum=9.9, aliases=("seconds",)),
        Arg("speed", "str", required=False, default="slow", choices=("slow", "fast")),
        Arg("count", "int", required=False, default=None, minimum=1),
        Arg("dry", "bool", required=False, default=False),
        Arg("nest", "station", required=False, default="default"),
        Arg("wells", "list", required=False, default=None),
        Arg("options", "dict", required=False, default=None),
        Arg("note", "any", required=False, default=None),
    ),
)


@pytest.mark.parametrize(
    ("args", "bound"),
    [
        ({"time": 3.0}, {"time": 3.0}),
        ({"time": 3}, {"time": 3.0}),
        ({"seconds": 3, "speed": "fast"}, {"time": 3.0, "speed": "fast"}),
        ({"time": 0.5, "count": None}, {"time": 0.5, "count": None}),
        (
            {"time": 9.9, "wells": ["A1"], "options": {"a": 1}},
            {"time": 9.9, "wells": ["A1"], "options": {"a": 1}},
        ),
        ({"time": 1.0, "note": "3"}, {"time": 1.0, "note": "3"}),
    ],
)
def test_good_arguments_are_bound_to_declared_names(args: dict[str, Any], bound: dict[str, Any]) -> None:
    assert list_problems(SEAL, args) == []
    result = bind(SEAL, args)
    assert result == bound
    assert isinstance(result["time"], float)


@pytest.mark.parametrize(
    ("args", "sentence"),
    [
        ({}, "seal: argument 'time' is missing: a number from 0.5 to 9.9 s."),
        ({"time": "3"}, "seal: argument 'time' must be a number from 0.5 to 9.9 s, not '3'."),
        ({"seconds": 10}, "seal: argument 'seconds' must be a number from 0.5 to 9.9 s, not 10."),
        ({"time": 0.49}, "seal: argument 'time' must be a number from 0.5 to 9.9 s, not 0.49."),
        ({"time": True}, "seal: argument 'time' must be a number from 0.5 to 9.9 s, not True."),
        ({"time": None}, "seal: argument 'time' must be a number from 0.5 to 9.9 s, not None."),
        ({"time": float("nan")}, "seal: argument 'time' must be a number from 0.5 to 9.9 s, not nan."),
        ({"time": 1, "seconds": 2}, "seal: argument 'seconds' is given twice, as time, seconds."),
        ({"time": 1, "speed": "warp"}, "seal: argument 'speed' must be one of 'slow', 'fast', not 'warp'."),
        ({"time": 1, "count": 0}, "seal: argument 'count' must be a whole number of at least 1, not 0."),
        ({"time": 1, "count": 1.0}, "seal: argument 'count' must be a whole number of at least 1, not 1.0."),
        (
            {"time": 1, "count": True},
            "seal: argument 'count' must be a whole number of at least 1, not True.",
        ),
        ({"time": 1, "dry": 1}, "seal: argument 'dry' must be true or false, not 1."),
        ({"time": 1, "dry": "true"}, "seal: argument 'dry' must be true or false, not 'true'."),
        ({"time": 1, "nest": 4}, "seal: argument 'nest' must be the name of a station, not 4."),
        ({"time": 1, "wells": "A1"}, "seal: argument 'wells' must be a list, not 'A1'."),
        (
            {"time": 1, "tiem": 2},
            "seal: argument 'tiem' is not known: "
            "seal takes time, speed, count, dry, nest, wells, options, note.",
        ),
    ],
)
def test_bad_arguments_are_told_in_one_sentence(args: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ActionInvalid) as caught:
        bind(SEAL, args)
    assert str(caught.value) == sentence


def test_all_problems_are_found_with_the_name_as_it_was_written() -> None:
    found = list_problems(SEAL, {"seconds": "3", "speed": 1, "extra": 0})
    assert [problem.argument for problem in found] == ["seconds", "speed", "extra"]
    assert all(isinstance(problem, ArgumentProblem) for problem in found)


def test_an_action_without_arguments() -> None:
    assert bind(ActionSpec("home"), {}) == {}
    with pytest.raises(ActionInvalid, match="home takes no arguments"):
        bind(ActionSpec("home"), {"fast": True})
