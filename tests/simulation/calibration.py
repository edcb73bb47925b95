"""How good forecasts are: what was expected when a run was submitted, against what came.

A simulated lab carries out mixed workflows, with devices whose motions scatter. From its log alone, each
submission is forecast as it was known at that moment: the state folded up to there, the durations learned
from what came before. ``python -m tests.simulation.calibration`` writes the page and the figure.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace

from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.envelope import Record
from labos.core.fold import evolve
from labos.core.runs import RunCompleted, RunStarted, RunSubmitted
from labos.core.state import LabState, from_picture, picture
from labos.planning.durations import Durations, quantile
from labos.planning.lab_forecast import ExpectedRun, ForecastRequest, forecast_lab
from labos.planning.newcomers import SubmissionHistory
from labos.planning.virtual import VirtualLab
from labos.services.log import events
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import CELL, NODES, make_generated, pcr, route, stand

SECOND = 1_000_000_000
PLENTY = 400
STEPS = 600
EVERY_S = 4_500.0
"""A run is submitted after so long on average: the lab is busy, and its queue does not grow without end."""

RUNS = 20
"""Runs of one lab."""

LIMIT_S = 4 * 24 * 3600.0
"""A lab whose runs have not ended by then is left; only what has ended is counted."""

BATCH, PAUSE_S = 4, 30_000.0
"""So many runs at once, and so long until the next ones: nobody submits anything meanwhile."""


class Case(msgspec.Struct, frozen=True):
    """A run: what was expected of it when it was submitted, and what came (UTC ns)."""

    expected: ExpectedRun
    submitted: int
    started: int
    ended: int


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


def cases(
    records: Sequence[Record],
    durations: Durations | None = None,
    history: SubmissionHistory | None = None,
    *,
    steps: int = STEPS,
) -> Iterator[Case]:
    """Forecast each submission of a log whose run has completed, and learn ``durations`` and ``history`` on
    the way."""
    started: dict[str, int] = {}
    ended: dict[str, int] = {}
    for event, head in events(records):
        if isinstance(event, RunStarted):
            started[event.run] = head.recorded_at
        elif isinstance(event, RunCompleted):
            ended[event.run] = head.recorded_at
    state, durations, history = LabState(), durations or Durations(), history or SubmissionHistory()
    for event, head in events(records):
        evolve(state, event, head.position, head.recorded_at)
        durations.learn(event, head.recorded_at)
        history.learn(event, head.recorded_at)
        if isinstance(event, RunSubmitted) and event.run in ended:
            question = ForecastRequest(
                picture(state), head.recorded_at, durations.spreads(), history.newcomers(), steps=steps
            )
            expected = next(run for run in forecast_lab(question).runs if run.run == event.run)
            yield Case(expected, head.recorded_at, started[event.run], ended[event.run])


def misses_with_true_durations(records: Sequence[Record]) -> list[float]:
    """By how many seconds runs ended later than foreseen by a lab that is told how long each action takes:
    of those that were submitted when all that came before their end was known."""
    asked: dict[str, tuple[str, int, int]] = {}
    took: dict[tuple[str, int], int] = {}
    ended: dict[str, int] = {}
    submitted: list[int] = []
    for event, head in events(records):
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
    for event, head in events(records):
        evolve(state, event, head.position, head.recorded_at)
        if not isinstance(event, RunSubmitted) or event.run not in ended:
            continue
        submitted.pop(0)
        if submitted and submitted[0] <= ended[event.run]:
            continue
        lab = VirtualLab(
            from_picture(picture(state)), head.recorded_at, lambda action, _: took[action.run, action.step]
        )
        found.append((ended[event.run] - lab.go_on().ends[event.run]) / SECOND)
    return found


class Figures(msgspec.Struct):
    """How many forecasts had a range, how many of their ranges held what came, the middle of the errors
    without sign (s, and as part of the time that was foreseen), and of the errors with sign (s)."""

    count: int
    covered: float
    error_s: float
    part: float
    bias_s: float


def figures(found: Sequence[Case], what: str) -> Figures:
    """``what`` is starts or ends."""
    errors: list[float] = []
    parts: list[float] = []
    held = 0
    for case in found:
        times = getattr(case.expected, what)
        if times is None:
            continue
        came = case.started if what == "starts" else case.ended
        held += times.earliest_at - SECOND <= came <= times.latest_at + SECOND
        errors.append((came - times.expected_at) / SECOND)
        parts.append(abs(errors[-1]) * SECOND / max(SECOND, times.expected_at - case.submitted))
    middle = [quantile(sorted(values), 0.5) for values in ([abs(e) for e in errors], parts, errors)]
    return Figures(len(errors), held / len(errors), *middle)


# -- the page --------------------------------------------------------------------------------------

FOLDER = Path(__file__).parents[2] / "docs"
SIZE, EDGE = 420, 50


def drawing(found: Sequence[Case]) -> str:
    """Hours from submission to end, expected and come, as an SVG with the range of each forecast."""
    points = []
    for case in found:
        if case.expected.ends is None:
            continue
        ends = case.expected.ends
        hours = [
            (ns - case.submitted) / 3600e9
            for ns in (ends.earliest_at, ends.expected_at, ends.latest_at, case.ended)
        ]
        points.append(hours)
    most = max(max(hours) for hours in points) * 1.03

    def x(value: float) -> str:
        return f"{EDGE + value / most * SIZE:.1f}"

    def y(value: float) -> str:
        return f"{EDGE / 2 + SIZE - value / most * SIZE:.1f}"

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE + 2 * EDGE}" height="{SIZE + 2 * EDGE}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{SIZE + 2 * EDGE}" height="{SIZE + 2 * EDGE}" fill="white"/>',
        f'<path d="M{x(0)} {y(most)}V{y(0)}H{x(most)}" fill="none" stroke="black"/>',
        f'<path d="M{x(0)} {y(0)}L{x(most)} {y(most)}" stroke="grey" stroke-dasharray="4"/>',
    ]
    for tick in range(0, int(most) + 1, max(1, int(most) // 8)):
        lines.append(f'<text x="{x(tick)}" y="{SIZE + EDGE}" text-anchor="middle">{tick}</text>')
        lines.append(f'<text x="{EDGE - 8}" y="{y(tick)}" text-anchor="end">{tick}</text>')
    for early, expected, late, came in points:
        held = early <= came <= late
        colour = "#1f77b4" if held else "#d62728"
        lines.append(f'<path d="M{x(came)} {y(early)}V{y(late)}" stroke="{colour}" stroke-opacity="0.5"/>')
        lines.append(f'<circle cx="{x(came)}" cy="{y(expected)}" r="2" fill="{colour}"/>')
    middle = EDGE + SIZE / 2
    lines.append(
        f'<text x="{middle}" y="{SIZE + 1.5 * EDGE}" text-anchor="middle">'
        "hours from submission to end, as it came</text>"
    )
    lines.append(
        f'<text transform="translate(14 {middle}) rotate(-90)" text-anchor="middle">'
        "hours, as forecast at submission</text>"
    )
    return "\n".join([*lines, "</svg>", ""])


def table(scenes: Mapping[str, Sequence[Case]]) -> str:
    """The figures for people."""
    lines = [
        "| runs | what | forecasts | within the range | middle error | as part of the time | bias |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, some in scenes.items():
        for what in ("starts", "ends"):
            told = figures(some, what)
            lines.append(
                f"| {name} | {what} | {told.count} | {told.covered:.0%} | {told.error_s:.0f} s | "
                f"{told.part:.1%} | {told.bias_s:+.0f} s |"
            )
    return "\n".join(lines)


def days(count: int, seed: int, *, batches: bool) -> list[Case]:
    """The cases of several labs with so many runs in all, whose durations are learned from one another."""
    durations, history, found = Durations(), SubmissionHistory(), list[Case]()
    for number in range(count // RUNS):
        history.pause()
        found += cases(log_of(RUNS, seed + number, batches=batches), durations, history)
    return found


def list_known(found: Sequence[Case]) -> list[Case]:
    """Those after which nobody submitted anything before they had ended: all was known at their forecast."""
    after = [*found[1:], None]
    return [
        case
        for case, following in zip(found, after, strict=True)
        if following is None or not case.submitted <= following.submitted <= case.ended
    ]


def main(count: int = 200, seed: int = 1) -> None:
    """Print the table and draw the figures."""
    alone = days(count, seed, batches=True)
    busy = days(count, seed, batches=False)
    (FOLDER / "pictures" / "forecast.svg").write_text(drawing([*list_known(busy), *list_known(alone)]))
    (FOLDER / "pictures" / "forecast-busy.svg").write_text(drawing(busy))
    scenes = {
        "one by one": busy,
        "of these: nobody came after": list_known(busy),
        f"in batches of {BATCH}": alone,
        "of these: the last of a batch": list_known(alone),
    }
    print(table(scenes))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
