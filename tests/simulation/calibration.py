"""How good forecasts are: what was expected when a run was submitted, against what came.

A simulated lab carries out mixed workflows, with devices whose motions scatter. From its log alone, each
submission is forecast as it was known at that moment: the state folded up to there, and how far off the
forecasts of the runs were that had ended by then. ``python -m tests.simulation.calibration`` prints the table
and draws the pictures of the page.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace

from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.envelope import Record
from labos.core.fold import evolve
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunStarted, RunSubmitted
from labos.core.state import LabState, encode_picture, from_picture
from labos.planner.lengths import find_quantile
from labos.planning.hindsight import TARGET, Hindsight, PastForecast, TimeRange, foresee
from labos.planning.virtual import Play, VirtualLab
from labos.services.log import decode_events
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import CELL, NODES, make_generated, pcr, route, stand

SECOND = 1_000_000_000
FAR = 2**62
PLENTY = 400
EVERY_S = 4_500.0
"""A run is submitted after so long on average: the lab is busy, and its queue does not grow without end."""

RUNS = 20
"""Runs of one lab."""

LIMIT_S = 4 * 24 * 3600.0
"""A lab whose runs have not ended by then is left; only what has ended is counted."""

BATCH, PAUSE_S = 4, 30_000.0
"""So many runs at once, and so long until the next ones: nobody submits anything meanwhile."""


HEARD = RunSubmitted | RunStarted | RunCompleted | RunFailed | RunCancelled
Heard = tuple[HEARD, int, Play | None]
"""What it is learned from how good forecasts are: an event, when it was recorded, and how the lab would have
gone on then."""

LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


def well_stocked() -> Stand:
    """The RPL workcell with more than any of these runs needs."""
    plain = stand()
    stations = tuple(
        replace(s, capacity=2 * PLENTY) if s.kind in ("stack", "waste") else s for s in CELL.workcell.stations
    )
    modules = tuple(
        replace(m, levels={name: 100 * most for name, most in m.levels.items()})
        for m in CELL.workcell.modules
    )
    cell = replace(CELL.workcell, stations=stations, modules=modules)
    return Stand(cell, tuple((place, kind, PLENTY) for place, kind, _ in plain.stock), NODES)


def jobs(count: int, seed: int, *, batches: bool) -> list[Job]:
    """So many runs of three users: PCRs and generated workflows, one after the other or in batches."""
    rng = random.Random(f"calibration/{seed}")
    cleared = [number for number in range(40) if route(number).plan.steps[-1].args["target"] == "wc.trash"]
    found: list[Job] = []
    at_s = 0.0
    for number in range(count):
        if not batches:
            at_s += rng.expovariate(1 / EVERY_S)
        elif number and number % BATCH == 0:
            at_s += PAUSE_S
        user = rng.choice(["ada", "bo", "cy"])
        if rng.random() < 0.4:
            found.append(pcr(f"j{number}", user, at_s))
        else:
            found.append(make_generated(f"j{number}", user, rng.choice(cleared), at_s))
    return found


def log_of(count: int, seed: int, *, batches: bool) -> list[Record]:
    """The log of a lab that carried out so many runs."""
    lab = SimulatedLab(well_stocked(), seed, QUIET)
    try:
        lab.run_for(jobs(count, seed, batches=batches), LIMIT_S)
        return list(lab.store.read())
    finally:
        lab.close()


def hear(records: Sequence[Record]) -> list[Heard]:
    """What a log tells of how good forecasts are: each submission is foreseen as it was known then."""
    state, found = LabState(), list[Heard]()
    for event, head in decode_events(records):
        evolve(state, event, head.position, head.recorded_at)
        if isinstance(event, HEARD):
            play = foresee(state, head.recorded_at) if isinstance(event, RunSubmitted) else None
            found.append((event, head.recorded_at, play))
    return found


def learn(
    labs: Sequence[Sequence[Heard]], target: float = TARGET, *, again: bool = False
) -> list[PastForecast]:
    """What was told of the runs of several labs with the same habits when they were submitted, or ``again``
    when others were; of those that have ended, by what was learned until then."""
    hindsight, found = Hindsight(target), list[PastForecast]()
    for heard in labs:
        asked: dict[tuple[str, int], PastForecast] = {}
        for event, at, play in heard:
            hindsight.learn(event, at, lambda play=play: play)  # type: ignore[misc]
            old = (past for some in hindsight.open_again.values() for past in some)
            asked.update({(past.run, past.at): past for past in (*hindsight.open.values(), *old)})
        # The next lab is another: the time until then tells nothing, and nobody comes in this one any more.
        for past in asked.values():
            past.next_at = past.next_at or FAR
        hindsight = replace(hindsight, open={}, open_again={}, pauses=[], last_at=0)
        found += [past for past in asked.values() if past.ended and (past.age > 0) == again]
    return found


def misses_with_true_durations(records: Sequence[Record]) -> list[float]:
    """By how many seconds runs ended later than foreseen by a lab that is told how long each action takes:
    of those that were submitted when all that came before their end was known."""
    asked: dict[str, tuple[str, int, int]] = {}
    took: dict[tuple[str, int], int] = {}
    ended: dict[str, int] = {}
    submitted: list[int] = []
    for event, head in decode_events(records):
        if isinstance(event, ActionRequested):
            asked[event.action] = (event.run, event.step, head.recorded_at)
        elif isinstance(event, ActionSucceeded):
            run, step, at = asked[event.action]
            took[run, step] = head.recorded_at - at
        elif isinstance(event, RunCompleted):
            ended[event.run] = head.recorded_at
        elif isinstance(event, RunSubmitted):
            submitted.append(head.recorded_at)
    state, found = LabState(), []
    for event, head in decode_events(records):
        evolve(state, event, head.position, head.recorded_at)
        if not isinstance(event, RunSubmitted) or event.run not in ended:
            continue
        submitted.pop(0)
        if submitted and submitted[0] <= ended[event.run]:
            continue
        lab = VirtualLab(
            from_picture(encode_picture(state)),
            head.recorded_at,
            lambda action, _: took[action.run, action.step],
        )
        found.append((ended[event.run] - lab.go_on().ends[event.run]) / SECOND)
    return found


class Figures(msgspec.Struct):
    """How many forecasts had a range, how many of their ranges held what came, the middle width of the
    ranges (s), the middle of the errors without sign (s, and as part of the time that was foreseen), and of
    the errors with sign (s). ``ideal_s`` is the middle width of the narrowest ranges of one width (as part of
    the time that was foreseen) that hold 80 %: whoever knows all errors can tell them."""

    count: int
    covered: float
    width_s: float
    ideal_s: float
    error_s: float
    part: float
    bias_s: float


def figures(found: Sequence[PastForecast], what: str, kind: str = "usual") -> Figures:
    """``what`` is `starts` or `ends`; ``kind`` is `usual` or `alone`."""
    errors: list[float] = []
    widths: list[float] = []
    parts: list[float] = []
    scales: list[float] = []
    held = 0
    for past in found:
        times, came = past.find_range(what, kind), past.find_actual(what)
        held += is_held(times, came)
        widths.append((times.latest_at - times.earliest_at) / SECOND)
        errors.append((came - times.expected_at) / SECOND)
        scales.append(max(SECOND, times.expected_at - past.at) / SECOND)
        parts.append(errors[-1] / scales[-1])
    width, scale, bias = (_middle(values) for values in (widths, scales, errors))
    error, part = (_middle(list(map(abs, values))) for values in (errors, parts))
    return Figures(len(errors), held / len(errors), width, _narrowest(parts) * scale, error, part, bias)


def is_held(times: TimeRange, came: int) -> bool:
    """Whether a time lies within a range, or within a second of it."""
    return times.earliest_at - SECOND <= came <= times.latest_at + SECOND


def _middle(values: Sequence[float]) -> float:
    return find_quantile(sorted(values), 0.5)


def _narrowest(values: Sequence[float]) -> float:
    """The width of the narrowest range that holds 80 % of these."""
    ordered = sorted(values)
    count = math.ceil(TARGET * len(ordered))
    return min(ordered[i + count - 1] - ordered[i] for i in range(len(ordered) - count + 1))


# -- the page --------------------------------------------------------------------------------------

FOLDER = Path(__file__).parents[2] / "docs"
SIZE, EDGE = 420, 50
BLUE, RED = "#1f77b4", "#d62728"
COLOURS = (BLUE, "#ff7f0e", "#2ca02c")


def draw_figure(found: Sequence[PastForecast], kind: str) -> str:
    """Hours from submission to end, expected and come, as an SVG with the range of each forecast."""
    points: list[list[float]] = []
    for past in found:
        times = past.find_range("ends", kind)
        told = (times.earliest_at, times.expected_at, times.latest_at, past.ended)
        points.append([(ns - past.at) / 3600e9 for ns in told])
    most = max(max(hours) for hours in points) * 1.03
    sheet = Sheet(most)
    lines = sheet.frame("hours from submission to end, as it came", "hours, as forecast at submission")
    lines += sheet.ticks({str(tick): tick for tick in range(0, int(most) + 1, max(1, int(most) // 8))})
    for early, expected, late, came_h in points:
        colour = BLUE if early <= came_h <= late else RED
        x, low, high = sheet.x(came_h), sheet.y(early), sheet.y(late)
        lines.append(f'<path d="M{x} {low}V{high}" stroke="{colour}" stroke-opacity="0.5"/>')
        lines.append(f'<circle cx="{x}" cy="{sheet.y(expected)}" r="2" fill="{colour}"/>')
    return "\n".join([*lines, "</svg>", ""])


def reliability_drawing(curves: Mapping[str, Sequence[float]]) -> str:
    """The part of ends that ranges were to hold, and that they held, as an SVG."""
    sheet = Sheet(1.0)
    lines = sheet.frame("part of ends that ranges were to hold", "part that they held")
    lines += sheet.ticks({f"{level:.0%}": level for level in (0.0, *LEVELS, 1.0)})
    for number, (name, parts) in enumerate(curves.items()):
        colour = COLOURS[number]
        points = [(sheet.x(level), sheet.y(part)) for level, part in zip(LEVELS, parts, strict=True)]
        path = " ".join(f"{x},{y}" for x, y in points)
        lines.append(f'<polyline points="{path}" fill="none" stroke="{colour}"/>')
        lines += [f'<circle cx="{x}" cy="{y}" r="3" fill="{colour}"/>' for x, y in points]
        lines.append(f'<text x="{EDGE + 12}" y="{EDGE + 16 * number}" fill="{colour}">{name}</text>')
    return "\n".join([*lines, "</svg>", ""])


class Sheet:
    """A square with axes from 0 to ``most``."""

    def __init__(self, most: float) -> None:
        self.most = most

    def x(self, value: float) -> str:
        return f"{EDGE + value / self.most * SIZE:.1f}"

    def y(self, value: float) -> str:
        return f"{EDGE / 2 + SIZE - value / self.most * SIZE:.1f}"

    def frame(self, below: str, beside: str) -> list[str]:
        """The beginning of the picture, with what its axes show and the line on which both are equal."""
        most, middle = self.most, EDGE + SIZE / 2
        left, right, top, bottom = self.x(0), self.x(most), self.y(most), self.y(0)
        return [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE + 2 * EDGE}" height="{SIZE + 2 * EDGE}" '
            'font-family="sans-serif" font-size="12">',
            f'<rect width="{SIZE + 2 * EDGE}" height="{SIZE + 2 * EDGE}" fill="white"/>',
            f'<path d="M{left} {top}V{bottom}H{right}" fill="none" stroke="black"/>',
            f'<path d="M{left} {bottom}L{right} {top}" stroke="grey" stroke-dasharray="4"/>',
            f'<text x="{middle}" y="{SIZE + 1.5 * EDGE}" text-anchor="middle">{below}</text>',
            f'<text transform="translate(14 {middle}) rotate(-90)" text-anchor="middle">{beside}</text>',
        ]

    def ticks(self, at: Mapping[str, float]) -> list[str]:
        lines: list[str] = []
        for name, value in at.items():
            lines.append(f'<text x="{self.x(value)}" y="{SIZE + EDGE}" text-anchor="middle">{name}</text>')
            lines.append(f'<text x="{EDGE - 8}" y="{self.y(value)}" text-anchor="end">{name}</text>')
        return lines


def table(scenes: Mapping[str, tuple[Sequence[PastForecast], str]]) -> str:
    """The figures for people; of each scene which kind of what was told."""
    lines = [
        "| runs | what | forecasts | within the range | middle width | in hindsight | middle error "
        "| of the time | bias |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, (some, kind) in scenes.items():
        for what in ("starts", "ends"):
            asked = [past for past in some if what == "ends" or past.start >= past.at]
            told = figures(asked, what, kind)
            lines.append(
                f"| {name} | {what} | {told.count} | {told.covered:.0%} | {told.width_s:.0f} s "
                f"| {told.ideal_s:.0f} s | {told.error_s:.0f} s | {told.part:.1%} | {told.bias_s:+.0f} s |"
            )
    return "\n".join(lines)


def days(count: int, seed: int, *, batches: bool) -> list[list[Heard]]:
    """What is heard in several labs with so many runs in all."""
    return [hear(log_of(RUNS, seed + number, batches=batches)) for number in range(count // RUNS)]


def keep_undisturbed(found: Sequence[PastForecast]) -> list[PastForecast]:
    """Those after which nobody submitted anything before they had ended: all was known at their forecast."""
    return [past for past in found if past.is_alone("ends")]


def reliability(labs: Sequence[Sequence[Heard]], kind: str) -> list[float]:
    """Which part of the ends came within ranges that were to hold the part of ``LEVELS``; ``kind`` is
    `usual`, or `alone` for those after which nobody came."""
    found: list[float] = []
    for level in LEVELS:
        told = learn(labs, level)
        some = told if kind == "usual" else keep_undisturbed(told)
        held = [is_held(past.find_range("ends", kind), past.ended) for past in some]
        found.append(sum(held) / max(1, len(held)))
    return found


def main(count: int = 200, seed: int = 101) -> None:
    """Print the table and draw the figures."""
    show(days(count, seed, batches=False), days(count, seed, batches=True), FOLDER / "pictures")


def show(single: Sequence[list[Heard]], together: Sequence[list[Heard]], pictures: Path) -> None:
    """The table and the figures of what was heard in labs where runs come one by one, and in batches."""
    busy, batches = learn(single), learn(together)
    (pictures / "forecast.svg").write_text(
        draw_figure([*keep_undisturbed(busy), *keep_undisturbed(batches)], "alone")
    )
    (pictures / "forecast-busy.svg").write_text(draw_figure(busy, "usual"))
    (pictures / "forecast-batches.svg").write_text(draw_figure(batches, "usual"))
    curves = {
        "one by one": reliability(single, "usual"),
        f"in batches of {BATCH}": reliability(together, "usual"),
        "all known: if nobody else submits": reliability([*single, *together], "alone"),
    }
    (pictures / "forecast-reliability.svg").write_text(reliability_drawing(curves))
    scenes = {
        "one by one": (busy, "usual"),
        f"in batches of {BATCH}": (batches, "usual"),
        "one by one, told again": (learn(single, again=True), "usual"),
        "one by one, all known": (keep_undisturbed(busy), "alone"),
        "in batches, all known": (keep_undisturbed(batches), "alone"),
    }
    print(table(scenes))
    print("|".join(["to hold ", *(f" {level:.0%} " for level in LEVELS)]))
    for name, parts in curves.items():
        print("|".join([f"{name} ", *(f" {part:.0%} " for part in parts)]))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
