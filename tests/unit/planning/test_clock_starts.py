"""A step that starts a clock is looked at again when its follower will be in time."""

from __future__ import annotations

from tests.support.bench import SECOND, small
from tests.unit.planning.test_reservations import code, picture, read, why


def test_a_clock_is_started_as_soon_as_what_is_in_flight_ends_in_time() -> None:
    """It is looked at again at that time, not only when the other step has ended."""
    lab = small()
    lab.start(lab.submit(picture(takes=300.0)))
    run = lab.submit(read(0.0, 100.0))
    wait = why(lab, run)
    assert wait is not None
    assert wait.until is not None
    soon = (wait.until - lab.now) / SECOND
    assert 210.0 < soon < 250.0
    lab.pump()
    lab.wait(soon)
    assert f"{run}#0" in lab.pump()


def test_it_is_looked_at_again_without_haste() -> None:
    """However little is missing, time passes before the next look."""
    lab = small()
    lab.start(lab.submit(picture(takes=300.0)))
    run = lab.submit(read(0.0, 100.0))
    looks = 0
    while code(lab, run) == "not_in_time":
        wait = why(lab, run)
        assert wait is not None
        assert wait.until is not None
        assert wait.until >= lab.now + SECOND
        lab.wait((wait.until - lab.now) / SECOND)
        looks += 1
    assert code(lab, run) == ""
    assert looks < 4
