"""How wrong forecasts were, learned from runs that have ended; and what this says about a new forecast.

For each submitted run outside of campaigns, the lab is simulated from its state at that time, with the usual
durations, as in a forecast. When the run has ended, its error is known, as a part of the predicted time.
Causes of errors are other runs that came meanwhile, a person who let the lab wait, and slower steps. A new
forecast is taken to be as wrong as the past ones that were most like it. These are alike in the predicted
time, in the age of the run, and in the pauses between submissions before.

Its range is the narrowest one that holds a given part of these errors. This part is adapted: each run that
ends outside its expected range widens later ranges, and each run that ends inside narrows them. So in the
long run the ranges hold the target part, whatever habits change (adaptive conformal inference, Gibbs and
Candès, 2021).

All of this follows from the log alone: the same log gives the same ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from statistics import median

import msgspec

from labos.core.fold import evolve
from labos.core.ids import RunId
from labos.core.registry import Event, decode
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunStarted, RunSubmitted
from labos.core.state import LabState, encode_picture, from_picture
from labos.planning.forecast import find_usual_time
from labos.planning.virtual import Play, VirtualLab, keep_first

TARGET = 0.8
"""The part of all times that ranges should hold."""

RATE = 0.02
"""The speed of adaptation. A miss raises the part that later ranges hold by this times the target. A hit
lowers it by this times the rest (1 - target)."""

MOST_LEVEL, MOST_BELOW = 0.98, 0.3
"""The part that ranges hold is at most ``MOST_LEVEL``, and at least the target minus ``MOST_BELOW``."""

KEPT = 200
"""The most past forecasts of ended runs that are kept: this number made at the submission of the run, and
this number made later."""

OPEN = 300
"""The most runs that have not ended and have forecasts. At this number, no new forecasts are made."""

ALIKE = 25
"""The most past forecasts that are used for a new one: those that are most like it."""

ENOUGH = 10
"""With fewer past forecasts than this, the assumed errors of an unknown lab count too."""

ASSUMED = (-0.05, -0.03, -0.01, 0.0, 0.0, 0.0, 0.04, 0.08, 0.2, 0.5)
ASSUMED_ALONE = (-0.06, -0.04, -0.02, -0.01, 0.0, 0.0, 0.01, 0.02, 0.04, 0.06)
"""The assumed errors of forecasts, as parts of the predicted time: in the usual case (``ASSUMED``), and if no
further run is submitted."""

NEW_NS = 60 * 10**9
"""How long after its submission a run counts as new (ns)."""

AGAIN, AGAIN_OF_ONE = 10, 4
"""When a run is submitted, forecasts of other runs are kept too: of at most ``AGAIN`` runs, those that end
next. At most ``AGAIN_OF_ONE`` are kept for each of these runs."""

PAUSES = 3
"""The most pauses between submissions that are compared: enough to recognise groups of four runs."""

FLOOR_NS = 60 * 10**9
"""The shortest predicted time to which an error is related (ns): a prediction for the next minute is as wrong
as one for a minute."""

WEIGHT_OF_PAUSES = 0.3
"""The weight of the last pause beside the predicted time (both as logarithms). Earlier pauses have smaller
weights."""

WEIGHT_OF_AGE = 0.3
"""The weight of the age of a run beside the predicted time (both as logarithms)."""

LOOKED_AT, MOST_STEPS = 60, 1_500
"""The most waiting runs, and the most steps, with which a lab of the past is simulated."""

Row = tuple[int, str, int, int, bytes]
"""(position, type, schema, recorded_at, payload) of a record of the log."""


class TimeRange(msgspec.Struct, frozen=True):
    """When something is expected, and the range in which it lies in four of five cases (UTC ns)."""

    earliest_at: int
    expected_at: int
    latest_at: int


class ExpectedTimes(msgspec.Struct, frozen=True):
    """A time in the usual case, and if no further run is submitted."""

    usual: TimeRange
    alone: TimeRange


class PastForecast(msgspec.Struct):
    """A past forecast of a run, made ``age`` ns after its submission, ``at`` a time. ``start`` and ``end``
    are the predicted times; ``shown_start`` and ``shown_end`` are the ranges that were shown. ``started`` and
    ``ended`` are the actual times (all UTC ns; 0: not yet). ``pauses`` are the last pauses between
    submissions until then (ns). ``next_at`` is the time of the next submission (UTC ns; 0: none yet)."""

    run: RunId
    at: int
    pauses: tuple[int, ...]
    start: int
    end: int
    shown_start: ExpectedTimes
    shown_end: ExpectedTimes
    started: int = 0
    ended: int = 0
    next_at: int = 0
    age: int = 0

    def find_expected(self, what: str) -> int:
        return self.start if what == "starts" else self.end

    def find_actual(self, what: str) -> int:
        return self.started if what == "starts" else self.ended

    def find_range(self, what: str, kind: str) -> TimeRange:
        """The range that was shown: `usual`, or `alone` if no further run is submitted."""
        expected = self.shown_start if what == "starts" else self.shown_end
        return expected.usual if kind == "usual" else expected.alone

    def is_alone(self, what: str) -> bool:
        """Whether no further run was submitted before the run started or ended (``what``)."""
        return not self.next_at or self.next_at > self.find_actual(what)

    def find_error(self, what: str) -> float:
        """How much later than predicted the run started or ended, as a part of the predicted time."""
        return (self.find_actual(what) - self.find_expected(what)) / _scale(
            self.find_expected(what) - self.at
        )


class Hindsight(msgspec.Struct):
    """The predicted and the actual times of runs, up to a ``position`` of the log. ``open`` and ``ended`` are
    the forecasts at the submission of each run. ``open_again`` and ``ended_again`` are later ones, made when
    other runs were submitted. ``last_at`` is the last submission (UTC ns). ``levels`` are the parts of the
    most similar errors that ranges hold at present, so that they hold ``target`` of the actual times."""

    target: float = TARGET
    position: int = 0
    last_at: int = 0
    pauses: list[int] = []
    open: dict[RunId, PastForecast] = {}
    ended: list[PastForecast] = []
    open_again: dict[RunId, list[PastForecast]] = {}
    ended_again: list[PastForecast] = []
    levels: dict[str, float] = {}

    # -- what is expected --------------------------------------------------------------------

    def expect(self, what: str, foreseen: int, now: int, age: int = 0) -> ExpectedTimes:
        """The expected times for a predicted time (``foreseen``, UTC ns) of a run that was submitted ``age``
        ns ago. ``what`` is `starts` or `ends`. If the predicted time is past, the ranges have no width."""
        if foreseen < now:
            return ExpectedTimes(*[TimeRange(foreseen, foreseen, foreseen)] * 2)
        known = self.ended if age < NEW_NS else self.ended_again
        asked = _RangeRequest(what, foreseen, now, age)
        return ExpectedTimes(
            self._find_range(asked, "usual", self._list_possible(known, now), ASSUMED),
            self._find_range(asked, "alone", [past for past in known if past.is_alone(what)], ASSUMED_ALONE),
        )

    def _list_possible(self, known: list[PastForecast], now: int) -> list[PastForecast]:
        """The forecasts after which no run was submitted for as long as none has been submitted now. All of
        them, if this leaves fewer than ``ENOUGH``."""
        waited = now - self.last_at if self.last_at else 0
        quiet = [past for past in known if not past.next_at or past.next_at - past.at >= waited]
        return quiet if len(quiet) >= ENOUGH else known

    def _find_range(
        self, asked: _RangeRequest, kind: str, known: list[PastForecast], assumed: Sequence[float]
    ) -> TimeRange:
        pauses = self.pauses if kind == "usual" else []
        parts = [past.find_error(asked.what) for past in asked.find_nearest(known, pauses)]
        if len(parts) < ENOUGH:
            parts += assumed
        parts.sort()
        low, high = _find_narrowest_range(
            parts, self.levels.get(_name_level(asked.what, kind, asked.age), self.target)
        )
        middle, scale = median(parts), _scale(asked.foreseen - asked.now)
        return TimeRange(
            *(max(asked.now, int(asked.foreseen + part * scale)) for part in (low, middle, high))
        )

    # -- learning ----------------------------------------------------------------------------

    def learn(self, event: Event, at: int, foresee: Callable[[], Play | None]) -> None:
        """Take in an event; events come in order. ``at`` is when it was recorded (UTC ns). ``foresee``
        simulates the lab from its state after this event; it is called only if a run was submitted. Runs of
        campaigns and closing runs are left out."""
        match event:
            case RunSubmitted() if not (event.campaign or event.closing):
                self._note_submission(event.run, at, foresee)
            case RunStarted() if event.run in self.open:
                for past in self._list_forecasts(event.run):
                    past.started = at
                    if past.start >= past.at:
                        self._adapt_ranges(past, "starts")
            case RunCompleted() if event.run in self.open:
                for past in self._list_forecasts(event.run):
                    past.ended = at
                    self._adapt_ranges(past, "ends")
                self.ended = [*self.ended, self.open.pop(event.run)][-KEPT:]
                self.ended_again = [*self.ended_again, *self.open_again.pop(event.run, [])][-KEPT:]
            case RunFailed() | RunCancelled():
                self.open.pop(event.run, None)
                self.open_again.pop(event.run, None)
            case _:
                pass

    def _list_forecasts(self, run: RunId) -> list[PastForecast]:
        return [self.open[run], *self.open_again.get(run, [])]

    def _note_submission(self, run: RunId, at: int, foresee: Callable[[], Play | None]) -> None:
        for past in (*self.open.values(), *self.ended, *self.ended_again):
            past.next_at = past.next_at or at
        for again in self.open_again.values():
            for past in again:
                past.next_at = past.next_at or at
        if self.last_at:
            self.pauses = [*self.pauses, at - self.last_at][-PAUSES:]
        self.last_at = at
        play = foresee() if len(self.open) < OPEN else None
        if play is None:
            return
        waited_for = sorted(self.open.keys() & play.ends.keys(), key=lambda name: (play.ends[name], name))
        for name in waited_for[:AGAIN]:
            known = self.open_again.setdefault(name, [])
            if at - self.open[name].at >= NEW_NS and len(known) < AGAIN_OF_ONE and name not in play.failed:
                known.append(self._foresee(name, at, play, self.open[name]))
        if run in play.starts and run in play.ends and run not in play.failed:
            self.open[run] = self._foresee(run, at, play)

    def _foresee(self, run: RunId, at: int, play: Play, first: PastForecast | None = None) -> PastForecast:
        """The forecast for a run now, with the ranges that are shown. ``first`` is the forecast at its
        submission, if this is a later one."""
        age, started = (at - first.at, first.started) if first is not None else (0, 0)
        start, end = play.starts[run], play.ends[run]
        ranges = self.expect("starts", start, at, age), self.expect("ends", end, at, age)
        return PastForecast(run, at, tuple(self.pauses), start, end, *ranges, started=started, age=age)

    def _adapt_ranges(self, past: PastForecast, what: str) -> None:
        """Widen later ranges if the actual time was outside the range of this forecast, else narrow them."""
        came = past.find_actual(what)
        for kind in ("usual", "alone"):
            if kind == "alone" and not past.is_alone(what):
                continue
            time_range, name = past.find_range(what, kind), _name_level(what, kind, past.age)
            missed = not time_range.earliest_at <= came <= time_range.latest_at
            level = self.levels.get(name, self.target) + RATE * (missed - (1 - self.target))
            self.levels[name] = min(MOST_LEVEL, max(self.target - MOST_BELOW, level))


class _RangeRequest(msgspec.Struct, frozen=True):
    """The prediction for which a range is asked: of the start or the end (``what``), for a time, made ``now``
    (both UTC ns), of a run of this ``age`` (ns)."""

    what: str
    foreseen: int
    now: int
    age: int

    def find_nearest(self, known: Sequence[PastForecast], pauses: Sequence[int]) -> list[PastForecast]:
        """The past forecasts that are most like this one, the nearest first. For a start, only those count
        that were made before the start."""
        waited = [past for past in known if self.what == "ends" or past.start >= past.at]
        return sorted(waited, key=lambda past: self._differ(past, pauses))[:ALIKE]

    def _differ(self, past: PastForecast, pauses: Sequence[int]) -> float:
        """How different a past forecast is from this one; 0 if it is the same."""
        foreseen, long = past.find_expected(self.what) - past.at, self.foreseen - self.now
        differs = abs(math.log(_scale(foreseen) / _scale(long)))
        differs += WEIGHT_OF_AGE * abs(math.log(_scale(past.age) / _scale(self.age)))
        both = zip(reversed(past.pauses), reversed(pauses), strict=False)
        for number, (one, other) in enumerate(both, 1):
            differs += WEIGHT_OF_PAUSES / number * abs(math.log1p(one / 1e9) - math.log1p(other / 1e9))
        return differs


def _name_level(what: str, kind: str, age: int) -> str:
    return f"{what} {kind}{'' if age < NEW_NS else ' again'}"


def _scale(foreseen_ns: int) -> int:
    return max(FLOOR_NS, foreseen_ns)


def _find_narrowest_range(ordered: Sequence[float], level: float) -> tuple[float, float]:
    """The narrowest range that holds the part ``level`` of all possible values, of which the ordered ones are
    a sample."""
    count = min(len(ordered), max(1, math.ceil(level * (len(ordered) + 1))))
    first = min(range(len(ordered) - count + 1), key=lambda i: ordered[i + count - 1] - ordered[i])
    return ordered[first], ordered[first + count - 1]


# -- from the log --------------------------------------------------------------------------------


class LookBack(msgspec.Struct):
    """What was learned up to a position of the log, and the encoded state there (empty: the beginning of the
    log)."""

    hindsight: Hindsight = msgspec.field(default_factory=Hindsight)
    picture: bytes = b""


def look_back(
    known: LookBack,
    rows: Iterable[Row],
    is_late: Callable[[], bool] = lambda: False,
    *,
    searches: bool = False,
) -> LookBack:
    """Learn from the records that follow. After a submission, stop if ``is_late`` says so. ``searches``: the
    lab searches for its own orders."""
    state = from_picture(known.picture) if known.picture else LabState()
    hindsight = known.hindsight
    for position, kind, schema, at, payload in rows:
        event = decode(kind, schema, payload)
        evolve(state, event, position, at)
        hindsight.learn(event, at, lambda at=at: foresee(state, at, searches=searches))  # type: ignore[misc]
        hindsight.position = position
        if isinstance(event, RunSubmitted) and is_late():
            break
    return LookBack(hindsight, encode_picture(state))


def foresee(state: LabState, now: int, *, searches: bool = False) -> Play | None:
    """How a lab would continue from now with the usual durations. None if the simulation needs too many
    steps."""
    copy = from_picture(encode_picture(state))
    keep_first(copy, LOOKED_AT)
    play = VirtualLab(
        copy,
        now,
        lambda action, step: find_usual_time(copy, step),
        most_steps=MOST_STEPS,
        orders={} if searches else None,
    ).go_on()
    return None if play.cut else play
