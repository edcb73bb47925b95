"""Who is to be looked at, and when."""

from __future__ import annotations

from labos.core import reasons
from labos.core.waits import Wait
from labos.planning.wait_list import WaitList


def wait(until: int | None) -> Wait:
    return Wait(reasons.SoonerLater(), (), until)


def test_who_waits_for_a_time_is_due_once_it_has_come_or_if_the_clock_was_set_back() -> None:
    wait_list = WaitList()
    for name, until in (("R1", 2_000), ("R2", 9_000), ("R3", None)):
        wait_list.add((name, 0), wait(until))
    assert wait_list.list_due(1_500) == []
    assert wait_list.list_due(2_000) == [("R1", 0)]
    assert wait_list.list_due(1_000) == [("R1", 0), ("R2", 0)]
    assert wait_list.list_due(1_001) == []
    wait_list.remove(("R1", 0))
    assert wait_list.list_due(900) == [("R2", 0)]
