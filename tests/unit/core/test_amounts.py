"""How long an action takes with its arguments."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.amounts import find_duration_s, set_duration
from labos.core.model import ActionSpec, Arg
from labos.errors import SpecError

ARGS = (
    Arg("seconds", "float", unit="s", required=False),
    Arg("minutes", "float", unit="min", required=False),
    Arg("hours", "float", unit="h", required=False),
    Arg("plain", "float", required=False),
    Arg("wells", "list", required=False),
    Arg("name", "str", required=False),
)


def shake(duration_from: str) -> ActionSpec:
    return ActionSpec("shake", args=ARGS, duration_s=60.0, duration_from=duration_from)


@pytest.mark.parametrize(
    ("written", "args", "expected_s"),
    [
        ("", {"seconds": 5}, 60),
        ("{seconds}", {"seconds": 5}, 5),
        ("20 + {seconds}", {"seconds": 5}, 25),
        ("2.5+{minutes}", {"minutes": 2}, 122.5),
        ("{hours}", {"hours": 0.5}, 1800),
        ("{plain}", {"plain": 7}, 7),
        ("4 + {wells.count}", {"wells": ["A1", "A2"]}, 6),
        ("{seconds}", {}, 60),
        ("{seconds}", {"seconds": None}, 60),
        ("20 + {seconds}", {"seconds": 0}, 20),
        ("{seconds}", {"seconds": 0}, 60),
    ],
)
def test_arguments_decide_how_long_it_takes(written: str, args: dict[str, Any], expected_s: float) -> None:
    assert find_duration_s(shake(written), args) == expected_s
    assert set_duration(shake(written), args).duration_s == expected_s


@pytest.mark.parametrize(
    ("written", "args", "message"),
    [
        ("seconds", {"seconds": 5}, "'seconds' is not a duration"),
        ("{seconds} + 20", {"seconds": 5}, "is not a duration"),
        ("{seconds}", {"seconds": -1}, "is -1"),
        ("{name}", {"name": "long"}, "is not a number"),
    ],
)
def test_what_is_no_duration_is_an_error(written: str, args: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError, match=message):
        find_duration_s(shake(written), args)
    assert set_duration(shake(written), args).duration_s == 60
