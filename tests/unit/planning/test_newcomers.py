"""Who may come is drawn from who came last, in the way in which they came."""

from __future__ import annotations

from labos.core.ids import ExperimentId
from labos.planning.lab_forecast import draw
from labos.planning.newcomers import ENOUGH, MOST, Newcomers, SubmissionHistory
from tests.support.bench import SECOND, Driver, module, plan, route, station, step, workcell

CELL = workcell([module("dev"), module("arm")], [station("stack", "stack", 40), station("a")])
HOUR = 3600.0


def learn_pauses(pauses: list[float]) -> tuple[Newcomers, int]:
    """What is known of runs that came after such pauses (s), and when the last one came."""
    lab = Driver(CELL)
    for number, pause in enumerate(pauses):
        lab.wait(pause)
        lab.submit(plan(step("dev"), name=f"w{number % 3}"), user=("ada", "bob")[number % 2])
    return learn_from(lab), lab.now


def learn_from(lab: Driver) -> Newcomers:
    history = SubmissionHistory()
    for entry in lab.log:
        history.learn(entry.event, entry.at)
    return history.newcomers()


def test_who_comes_in_fours_comes_so_again() -> None:
    pauses = [8 * HOUR, 1.0, 1.0, 1.0] * 6
    known, now = learn_pauses([*pauses, 8 * HOUR, 1.0])
    for play in range(20):
        come = known.draw(now, lambda word, play=play: draw(f"{play}/{word}"))  # type: ignore[misc]
        soon = [at for at, _ in come if at < now + HOUR * SECOND]
        assert len(soon) == 2, "two of this batch are missing"
    known, now = learn_pauses(pauses)
    come = known.draw(now, lambda word: draw(word))
    assert come[0][0] == now + int(8 * HOUR) * SECOND
    assert len(come) == MOST
    assert [at for at, _ in come] == sorted(at for at, _ in come)


def test_of_few_nothing_is_expected() -> None:
    known, now = learn_pauses([60.0] * ENOUGH)
    assert known.draw(now, draw) == []


def test_when_nobody_has_come_for_longer_than_ever_nobody_is_expected() -> None:
    known, now = learn_pauses([60.0] * 20)
    assert known.draw(now + 30 * SECOND, draw)[0][0] == now + 60 * SECOND
    assert known.draw(now + 61 * SECOND, draw) == []


def test_runs_of_experiments_come_with_them_and_not_by_themselves() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 20)
    home = lab.experiment()
    for _ in range(12):
        lab.wait(60.0)
        lab.submit(route("stack", "a"), experiment=ExperimentId(home))
    assert learn_from(lab) == Newcomers()
