"""What is said of a step while nothing happens."""

from __future__ import annotations

from typing import Any

import pytest

from labos.cli._narrate import describe_step

STEP = {"key": "Mix", "module": "ot2", "action": "run_protocol", "state": "in flight", "left_s": 90.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "'Mix': ot2 is at run_protocol, about 1 min 30 s left"),
        ({"left_s": None}, "'Mix': ot2 is at run_protocol"),
        ({"state": "unknown"}, "'Mix': it is unknown how run_protocol on ot2 ended"),
    ],
)
def test_how_long_a_step_takes_is_said_only_where_it_is_known(change: dict[str, Any], words: str) -> None:
    assert describe_step({**STEP, **change}) == words
