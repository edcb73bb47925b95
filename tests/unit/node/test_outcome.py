"""How an action that fails is told."""

from __future__ import annotations

import asyncio

import pytest

from labos.errors import Collision, DeviceError
from labos.node import Crash
from labos.node._outcome import find_outcome


async def fail(error: Exception) -> None:
    raise error


@pytest.mark.parametrize(
    ("error", "effects", "collided"),
    [
        (DeviceError("It is locked.", effects="none"), "none", False),
        (Collision("It has hit the hotel."), "unknown", True),
        (Collision("It is jammed.", effects="none"), "none", True),
        (Crash("arm puts plate on plate"), "unknown", True),
        (KeyError("pose"), "unknown", False),
    ],
)
def test_a_collision_is_told_from_other_errors(error: Exception, effects: str, collided: bool) -> None:
    outcome = asyncio.run(find_outcome("transfer", fail(error), broken_off=lambda: False))
    assert (outcome.succeeded, outcome.effects, outcome.collided) == (False, effects, collided)
