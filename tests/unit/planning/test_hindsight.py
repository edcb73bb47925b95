"""Ranges hold what they should, by how far off the forecasts of runs were that have ended."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from labos.core.ids import CampaignId, ExperimentId, RunId
from labos.core.runs import RunCompleted, RunFailed, RunStarted, RunSubmitted
from labos.planning.hindsight import (
    ASSUMED,
    ENOUGH,
    KEPT,
    OPEN,
    TARGET,
    Hindsight,
    LookBack,
    PastForecast,
    Row,
    TimeRange,
    look_back,
)
from labos.planning.virtual import Play
from tests.support.bench import SECOND, START
from tests.unit.services.logbook import Logbook

HOUR = 3600 * SECOND
DAY = 24 * HOUR


class Log:
    """Submissions that were foreseen for some time and came at another."""

    def __init__(self, hindsight: Hindsight | None = None) -> None:
        self.hindsight = hindsight or Hindsight()
        self.count, self.now = 0, START

    def submit(self, after: int, foreseen: int, *, beside: PastForecast | None = None) -> PastForecast:
        """A run that should end so long after its submission; the one beside it as before."""
        self.now += after
        self.count += 1
        run = RunId(f"R{self.count}")
        event = RunSubmitted(run, "plan", "pcr", "ada", ExperimentId(""), 0, {}, {})
        play = Play({run: self.now}, {run: self.now + foreseen})
        if beside is not None:
            play.starts[beside.run], play.ends[beside.run] = beside.start, beside.end
        self.hindsight.learn(event, self.now, lambda: play)
        return self.hindsight.open[run]

    def end(self, past: PastForecast, took: int) -> None:
        """It ends so long after its submission."""
        self.hindsight.learn(RunStarted(past.run), past.at, no_play)
        self.hindsight.learn(RunCompleted(past.run, 1), past.at + took, no_play)

    def one(self, took: float, foreseen: int = HOUR) -> PastForecast:
        """A run of a day on which nobody else comes."""
        past = self.submit(DAY, foreseen)
        self.end(past, int(took * foreseen))
        return past


def no_play() -> Play:
    raise AssertionError("only submissions are foreseen")


def width(times: TimeRange) -> float:
    return (times.latest_at - times.earliest_at) / SECOND


def is_held(past: PastForecast) -> bool:
    return past.shown_end.usual.earliest_at <= past.ended <= past.shown_end.usual.latest_at


def test_of_a_lab_of_which_nothing_is_known_something_is_assumed() -> None:
    told = Hindsight().expect("ends", START + 10 * HOUR, START)
    assert START < told.usual.earliest_at < told.usual.expected_at < told.usual.latest_at
    assert width(told.alone) < width(told.usual) <= (max(ASSUMED) - min(ASSUMED)) * 36_000
    assert Hindsight().expect("starts", START - 1, START).usual == TimeRange(*[START - 1] * 3), "it has come"


def test_who_is_always_late_by_a_tenth_is_expected_so() -> None:
    log = Log()
    for number in range(ENOUGH + 5):
        log.one(1.1 + 0.001 * (number % 5))
    told = log.hindsight.expect("ends", log.now + DAY, log.now).usual
    assert told.expected_at - log.now == pytest.approx(1.102 * DAY)
    assert width(told) <= 0.0041 * 24 * 3600


@pytest.mark.parametrize("seed", range(3))
def test_in_the_long_run_four_of_five_come_within_their_range_though_habits_change(seed: int) -> None:
    rng, log, held = random.Random(seed), Log(), list[bool]()
    for number in range(800):
        late = rng.gauss(1.0, 0.02) if number < 400 else rng.choice([1.0, 1.0, 1.5]) * rng.gauss(1.3, 0.2)
        held.append(is_held(log.one(max(0.1, late), rng.randrange(1, 9) * HOUR)))
    for part in (held[50:400], held[400:]):
        assert TARGET - 0.06 <= sum(part) / len(part) <= TARGET + 0.06
    assert len(log.hindsight.ended) == KEPT


def come_in_fours(log: Log, days: int) -> Iterator[list[PastForecast]]:
    """Each day four runs come at once, and each waits for those behind it."""
    for _ in range(days):
        four = [log.submit(DAY if place == 0 else SECOND, HOUR) for place in range(4)]
        yield four
        for place, past in enumerate(four):
            log.end(past, int((4 - place + 0.01 * (log.count % 7)) * HOUR))


def test_who_comes_in_fours_is_expected_in_fours() -> None:
    log = Log()
    *_, last_day = come_in_fours(log, 50)
    first, *_, last = (past.shown_end.usual for past in last_day)
    assert first.expected_at - last_day[0].at == pytest.approx(4 * HOUR, rel=0.05)
    assert last.expected_at - last_day[3].at == pytest.approx(HOUR, rel=0.1)
    assert width(last) < 600
    alone = last_day[0].shown_end.alone
    assert alone.expected_at - last_day[0].at == pytest.approx(HOUR, rel=0.1), "if nobody else submits"


def test_a_run_under_way_is_expected_as_others_were_that_had_come_as_far() -> None:
    log = Log()
    for number in range(ENOUGH + 5):
        long = log.submit(DAY, 10 * HOUR)
        short = log.submit(5 * HOUR, HOUR, beside=long)
        log.end(short, HOUR)
        log.end(long, 15 * HOUR + number * SECOND)
    new = log.hindsight.expect("ends", log.now + 10 * HOUR, log.now).usual
    old = log.hindsight.expect("ends", log.now + 4 * HOUR, log.now, 6 * HOUR).usual
    assert new.latest_at - log.now == pytest.approx(15 * HOUR, rel=0.01)
    assert old.expected_at - log.now == pytest.approx(8 * HOUR, rel=0.01), "twice as long as was left"
    assert not log.hindsight.open_again


def test_nobody_is_expected_any_more_once_they_would_have_come() -> None:
    log = Log()
    for _ in come_in_fours(log, 50):
        pass
    past = log.submit(DAY, 3 * HOUR)
    at_once = log.hindsight.expect("ends", past.end, log.now).usual
    later = log.hindsight.expect("ends", past.end, log.now + HOUR).usual
    assert at_once.expected_at > past.end + 5 * HOUR
    assert later.latest_at < past.end + HOUR


def test_what_failed_what_is_not_in_sight_and_rows_of_campaigns_tell_nothing() -> None:
    log = Log()
    failed = log.submit(DAY, HOUR)
    log.hindsight.learn(RunFailed(failed.run, "step", "broken"), log.now + HOUR, no_play)
    event = RunSubmitted(RunId("R8"), "plan", "pcr", "ada", ExperimentId(""), 0, {}, {})
    log.hindsight.learn(event, log.now + DAY, Play)
    row = RunSubmitted(
        RunId("R9"), "plan", "pcr", "ada", ExperimentId(""), 0, {}, {}, campaign=CampaignId("C1")
    )
    log.hindsight.learn(row, log.now + DAY, no_play)
    assert not log.hindsight.open
    assert not log.hindsight.ended


def test_a_crowd_takes_a_bounded_place() -> None:
    log = Log()
    for _ in range(OPEN):
        log.submit(SECOND, HOUR)
    log.hindsight.learn(
        RunSubmitted(RunId("R0"), "plan", "pcr", "ada", ExperimentId(""), 0, {}, {}), log.now, no_play
    )
    assert len(log.hindsight.open) == OPEN


def test_the_log_alone_tells_it_again_in_however_many_parts_it_is_read() -> None:
    book = Logbook()
    book.furnish()
    for _ in range(4):
        runs = [book.submit("pcr", user) for user in ("ada", "bo")]
        for run in runs:
            book.carry_through(run, seconds=30.0)
    rows: list[Row] = [
        (r.head.position, r.head.type, r.head.schema, r.head.recorded_at, r.payload) for r in book.records
    ]
    once = look_back(LookBack(), rows)
    assert len(once.hindsight.ended) == 8
    assert once.hindsight.position == book.position
    parts = LookBack()
    for first in range(0, len(rows), 100):
        parts = look_back(parts, rows[first : first + 100])
    assert parts == once
    late = look_back(LookBack(), rows, lambda: True)
    assert 0 < late.hindsight.position < book.position
    assert look_back(late, rows[late.hindsight.position :]) == once, "what is left is learned later"
