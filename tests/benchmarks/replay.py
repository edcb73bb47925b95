"""Folding a long log, against reading the same rows and decoding their JSON.

The log is that of a quiet mix of PCRs, colour pickers and generated routes, written again and again
with fresh names; in between a person clears the bench and refills the stacks.

Judged is the work (CPU time) of the process, which a busy machine stretches less than the time on the
wall; both are shown.
"""

from __future__ import annotations

import asyncio
import gc
import re
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import msgspec

from labos.clock import SystemClock, Uuid7Ids
from labos.core.ids import LabId
from labos.core.lab import KernelStarted
from labos.core.labware import LabwareRemoved, StationDeclared
from labos.core.registry import Event, decode
from labos.core.resources import LevelSet
from labos.core.runs import RunSubmitted
from labos.core.state import LabState, encode_picture, fold_fingerprint
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import Ledger, fold, load
from labos.runtime.writer import ThreadWriter
from labos.store import SqlEventStore, open_store
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.benchmarks.figures import Figure, Report, median, scratch, spread, times
from tests.simulation.mixes import mix, stand

MUST, MUST_SNAPSHOT_S, MUST_READY_S, MUST_READY_BARE_S = 6.0, 1.0, 2.0, 20.0
BATCH = 4000
SEED = 4
_NAMES = re.compile(rb'"((?:run:|experiment:)?)([RPE])(\d+)"|"kernel-(\d+)"')


class TickingClock(SystemClock):
    """Every look at it is a millisecond later, as in a log that took long to write."""

    def __init__(self) -> None:
        self._now = 1_700_000_000_000_000_000

    def now_ns(self) -> int:
        self._now += 1_000_000
        return self._now


class Pattern:
    """The log of one mix, to be written again with fresh names."""

    def __init__(self, seed: int) -> None:
        lab = SimulatedLab(stand(), seed, QUIET)
        try:
            self.end = lab.run(mix(seed))
            records = list(lab.store.records)
        finally:
            lab.close()
        first = next(i for i, r in enumerate(records) if r.head.type in ("run.submitted", "plan.recorded"))
        while records[first - 1].head.type.startswith(("experiment.", "plan.")):
            first -= 1
        self.begin = LabState()
        fold(self.begin, records[:first])
        self.set_up = [decode(r.head.type, r.head.schema, r.payload) for r in records[:first]]
        self.rows = [(r.head.type, r.head.schema, r.payload) for r in records[first:]]

    def again(self, number: int, state: LabState) -> Iterator[Event]:
        """All its events with names that follow those that the state has given out."""
        offsets = {
            b"R": state.runs.named - self.begin.runs.named,
            b"P": state.bench.named - self.begin.bench.named,
            b"E": state.experiments.named - self.begin.experiments.named,
        }

        def fresh(found: re.Match[bytes]) -> bytes:
            owner, letter, name, action = found.groups()
            if action is not None:
                return b'"kernel-%d-%b"' % (number, action)
            return b'"%b%b%d"' % (owner, letter, int(name) + offsets[letter])

        for kind, schema, payload in self.rows:
            yield decode(kind, schema, _NAMES.sub(fresh, payload))

    def clear_bench(self, state: LabState) -> Iterator[Event]:
        """What brings the bench back to how it was at first."""
        for name, item in list(state.bench.labware.items()):
            yield LabwareRemoved(name, "", item.station, "carried away")
        for place, station in self.begin.bench.stations.items():
            if station.spec.kind in ("stack", "waste"):
                yield StationDeclared(place, tuple(station.stock))
        for key, level in self.begin.resources.levels.items():
            module, _, resource = key.rpartition(":")
            yield LevelSet(module, resource, level.level, level.capacity)  # type: ignore[arg-type]


def write_log(store: SqlEventStore, events: int, pattern: Pattern) -> tuple[LabState, Counter[str], float]:
    """Fill a store; returns the state at its end, how many of which type, and how long it took."""
    began = time.perf_counter()
    head = store.claim(LabId("benchmark"), "benchmark", 3600.0)
    state = LabState()
    ledger = Ledger(state, head, TickingClock(), Uuid7Ids())
    counts: Counter[str] = Counter()
    batch = []
    repetition = 0

    def stream() -> Iterator[Event]:
        nonlocal repetition
        for event in pattern.set_up:
            # The lab of the pattern is not this one.
            yield (
                msgspec.structs.replace(event, epoch=head.epoch)
                if isinstance(event, KernelStarted)
                else event
            )
        while True:
            repetition += 1
            yield from pattern.again(repetition, state)
            yield from pattern.clear_bench(state)

    for event in stream():
        batch.append(ledger.write(event, "ada" if isinstance(event, RunSubmitted) else "labos"))
        counts[event.TYPE] += 1
        if len(batch) >= BATCH or state.position >= events:
            head = store.append(head, [entry.record for entry in batch])
            batch.clear()
            if state.position >= events:
                break
    store.release(head.epoch)
    return state, counts, time.perf_counter() - began


def raw(path: Path) -> Took:
    """How long it takes to read what a fold needs of every row and to decode its JSON."""
    decode_json = msgspec.json.Decoder().decode
    connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        began, worked = time.perf_counter(), time.process_time()
        rows = connection.execute(
            'SELECT position, type, "schema", recorded_at, payload FROM event ORDER BY position'
        )
        for row in rows:
            decode_json(row[4])
        return Took(time.perf_counter() - began, time.process_time() - worked)
    finally:
        connection.close()


class Took(msgspec.Struct, frozen=True):
    """By the clock on the wall, and what of that this process has worked: on a busy machine the second is
    the one to look at."""

    wall_s: float
    cpu_s: float

    def __str__(self) -> str:
        return f"{self.wall_s:.2f} s ({self.cpu_s:.2f} s of work)"


def middle(rounds: list[Took]) -> Took:
    return Took(median([took.wall_s for took in rounds]), median([took.cpu_s for took in rounds]))


async def ready(path: Path) -> Took:
    """How long until a kernel has opened the database, its own start is on disk and it has looked for
    what may start: the first decision is possible, and from then on it schedules."""
    gc.collect()
    began, worked = time.perf_counter(), time.process_time()
    store = open_store(f"sqlite:///{path}", home=path.parent)
    kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings(snapshot_every=10**9))
    await kernel.open()
    kernel.wake()
    took = Took(time.perf_counter() - began, time.process_time() - worked)
    # As after a kill: no new snapshot is kept.
    await kernel._writer.close()
    for task in kernel._tasks:
        task.cancel()
    store.release(kernel.epoch)
    store.close()
    return took


def measure(events: int = 1_000_000, rounds: int = 3, tail: int = 50_000) -> Report:
    pattern = Pattern(SEED)
    with scratch("replay") as folder:
        path = folder / "labos.db"
        store = open_store(f"sqlite:///{path}", home=path.parent)
        state, counts, wrote = write_log(store, events, pattern)
        wanted = encode_picture(state)
        ratios: list[float] = []
        ours: list[Took] = []
        limits: list[Took] = []
        parts: list[float] = []
        raw(path)  # both read from the page cache
        for _ in range(rounds):
            gc.collect()
            limits.append(raw(path))
            began, worked = time.perf_counter(), time.process_time()
            folded, number = load(store, snapshots=False)
            ours.append(Took(time.perf_counter() - began, time.process_time() - worked))
            assert number == events
            assert encode_picture(folded) == wanted, "the fold does not repeat itself"
            ratios.append(ours[-1].cpu_s / limits[-1].cpu_s)
            began = time.perf_counter()
            for _ in store.replay():
                pass
            parts.append(time.perf_counter() - began)
        store.close()
        bare = [asyncio.run(ready(path)) for _ in range(rounds)]
        store = open_store(f"sqlite:///{path}", home=path.parent)
        at = max(events - tail, 1)
        early = LabState()
        fold(early, store.read(upto=at))
        record = next(store.read(after=at - 1, upto=at))
        store.save_snapshot(at, record.hash, fold_fingerprint(), encode_picture(early))
        store.close()
        starts = [asyncio.run(ready(path)) for _ in range(rounds)]
        size = path.stat().st_size
    ratio, limit, fold_took = median(ratios), middle(limits), middle(ours)
    with_snapshot, without = middle(starts), middle(bare)
    figures = [
        Figure(
            f"replay and fold of {events:,} events",
            f"{fold_took}, {fold_took.cpu_s / events * 1e6:.1f} µs/event",
            f"{limit} (read + JSON)",
            times(ratio),
            f"≤ {MUST:.0f} ×",
            ratio <= MUST,
        ),
        Figure(
            f"the same with a snapshot {min(tail, events - 1):,} events before the end, to ready to schedule",
            str(with_snapshot),
            str(limit),
            times(with_snapshot.cpu_s / limit.cpu_s),
            f"≤ {MUST_READY_S:.0f} s (aim {MUST_SNAPSHOT_S:.0f} s)",
            with_snapshot.cpu_s <= MUST_READY_S,
        ),
        Figure(
            "the same without a snapshot, to ready to schedule",
            str(without),
            str(limit),
            times(without.cpu_s / limit.cpu_s),
            f"≤ {MUST_READY_BARE_S:.0f} s",
            without.cpu_s <= MUST_READY_BARE_S,
        ),
    ]
    common = ", ".join(f"{name} {count / events:.0%}" for name, count in counts.most_common(6))
    notes = [
        f"ratios of work in {rounds} rounds: {spread(ratios)}; "
        f"reading as tuples alone took {median(parts):.1f} s",
        f"log: {size / events:.0f} bytes on disk an event; {len(pattern.rows)} events a mix; {common}",
        f"written through the ledger in {wrote:.0f} s ({wrote / events * 1e6:.0f} µs/event, store included); "
        f"snapshot {len(wanted):,} bytes",
    ]
    return Report(figures, notes)


def smoke() -> Report:
    return measure(1500, 1, 500)
