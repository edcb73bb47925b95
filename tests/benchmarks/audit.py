"""The tables beside a long log: how long the projector takes, against reading the same rows and decoding
their JSON; and how long questions take that auditors ask of them.

The log is that of the benchmark ``replay``. Judged is the work (CPU time) of the process, as there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from labos.audit.database import open_audit
from labos.audit.difference import list_differences
from labos.audit.projector import Projector
from labos.audit.provenance import subject_of, trace
from labos.audit.query import ReadConnection, open_asker
from labos.store import open_store
from tests.benchmarks.figures import Figure, Report, milliseconds, scratch, spread, times
from tests.benchmarks.replay import SEED, Pattern, Took, middle, raw, write_log

MUST_S, MUST_ANSWER_S = 60.0, 1.0


def project(path: Path) -> Took:
    """All of the log into empty tables."""
    url = f"sqlite:///{path}"
    store, tables = open_store(url, create=False, read_only=True, home=path.parent), open_audit(url)
    try:
        tables.reset()
        began, worked = time.perf_counter(), time.process_time()
        Projector(store, tables).catch_up()
        return Took(time.perf_counter() - began, time.process_time() - worked)
    finally:
        tables.close()
        store.close()


def questions(asker: ReadConnection, end: int) -> dict[str, Callable[[], object]]:
    """What auditors ask, by what it is: each about the middle of the log."""
    at = end // 2
    (((plate, well),)) = asker.fetch(
        "SELECT labware, well FROM transfers WHERE position <= ? AND kind = 'in' "
        "ORDER BY position DESC LIMIT 1",
        at,
    )
    ((run, step),) = asker.fetch(
        "SELECT run, step FROM actions WHERE result IS NOT NULL AND ended_position <= ? "
        "ORDER BY requested_position DESC LIMIT 1",
        at,
    )
    ((driver,),) = asker.fetch("SELECT driver FROM nodes ORDER BY position LIMIT 1")

    def graph(subject: str, direction: str) -> Callable[[], object]:
        return lambda: trace(asker, subject_of(asker, subject, end), end, direction)  # type: ignore[arg-type]

    def rows(query: str, *values: object) -> Callable[[], object]:
        return lambda: asker.fetch(query, *values)

    touched = (
        "SELECT e.position, e.at, e.type, e.actor FROM labware_touches t JOIN events e "
        "ON e.position = t.position WHERE t.labware = ? ORDER BY e.position"
    )
    sealed = (
        "SELECT a.labware, a.requested_at FROM actions a JOIN runs r ON r.run = a.run WHERE a.name = 'seal' "
        "AND CAST(a.args ->> 'temperature' AS REAL) > 170 AND r.user_id = ?"
    )
    version = "SELECT DISTINCT run FROM actions WHERE driver = ? AND driver_version = ?"
    return {
        "what touched a plate": rows(touched, plate),
        "plates that a user had sealed above 170 °C": rows(sealed, "ada"),
        "which runs used a driver's version": rows(version, driver, "1"),
        "provenance of a well, up": graph(f"{plate}/{well}", "up"),
        "provenance of a well, down": graph(f"{plate}/{well}", "down"),
        "provenance of a result, up": graph(f"{run}#{step}", "up"),
        "provenance of a run, down": graph(run, "down"),
        "difference between two moments": lambda: list_differences(asker, at // 2, at),
    }


def measure(events: int = 1_000_000, rounds: int = 3) -> Report:
    with scratch("audit") as folder:
        path = folder / "labos.db"
        store = open_store(f"sqlite:///{path}", home=path.parent)
        write_log(store, events, Pattern(SEED))
        store.close()
        raw(path)  # both read from the page cache
        limits, ours = [], []
        for _ in range(rounds):
            limits.append(raw(path))
            ours.append(project(path))
        size = (folder / "labos-audit.db").stat().st_size
        figures = [_projection(events, middle(limits), middle(ours))]
        with open_asker(f"sqlite:///{path}") as asker:
            for name, question in questions(asker, events).items():
                figures.append(_answer(name, events, middle([_time(question) for _ in range(rounds)])))
    ratios = [took.cpu_s / limit.cpu_s for took, limit in zip(ours, limits, strict=True)]
    note = f"ratios of work in {rounds} rounds: {spread(ratios)}"
    notes = [f"{note}; {size / events:.0f} bytes of tables an event"]
    return Report(figures, notes)


def _projection(events: int, limit: Took, took: Took) -> Figure:
    must = MUST_S * max(1.0, events / 1_000_000)
    return Figure(
        f"{events:,} events into the tables",
        f"{took}, {took.cpu_s / events * 1e6:.1f} µs/event",
        f"{limit} (read + JSON)",
        times(took.cpu_s / limit.cpu_s),
        f"≤ {must:.0f} s of work",
        took.cpu_s <= must,
    )


def _answer(name: str, events: int, took: Took) -> Figure:
    ours = f"{milliseconds(took.wall_s)} ({milliseconds(took.cpu_s)} of work)"
    must = f"≤ {MUST_ANSWER_S:.0f} s of work"
    return Figure(f"{name}, {events:,} events", ours, must=must, ok=took.cpu_s <= MUST_ANSWER_S)


def _time(question: Callable[[], object]) -> Took:
    began, worked = time.perf_counter(), time.process_time()
    question()
    return Took(time.perf_counter() - began, time.process_time() - worked)


def smoke() -> Report:
    return measure(1500, 1)
