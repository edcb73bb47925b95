"""One durable action: from the start of its step until its result is on disk.

The limit is three commits (request, acceptance, result) of the very batches that LabOS wrote, to a
second log of the same kind beside it, and 0.3 ms for a message there and back.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec

from labos.clock import Uuid7Ids
from labos.core.actions import ActionAccepted, ActionRequested, ActionSucceeded
from labos.core.envelope import Record, seal
from labos.core.ids import LabId
from labos.core.registry import Event
from labos.ports import Head
from labos.runtime.ledger import Entry
from labos.store import SqlEventStore, open_store
from tests.benchmarks.figures import Figure, Report, median, milliseconds, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab

MESSAGE_S = 0.0003
MUST = 1.5


class BareLog:
    """A log of its own to which the batches of another are written again."""

    def __init__(self, folder: Path) -> None:
        self.store: SqlEventStore = open_store(f"sqlite:///{folder}/bare.db")
        self.head = self.store.claim(LabId("bare"), "benchmark", 60.0)
        self.ids = Uuid7Ids()

    def prepare(self, entries: Sequence[Entry], head: Head) -> tuple[list[Record], Head]:
        """Records of the same kind and size, behind ``head``."""
        records: list[Record] = []
        for entry in entries:
            position = head.position + 1
            at = msgspec.structs.replace(
                entry.record.head,
                lab=head.lab,
                position=position,
                id=self.ids.new(),
                version=position,
                recorded_at=max(head.recorded_at, entry.record.head.recorded_at),
            )
            record = seal(head.hash, at, entry.record.payload)
            records.append(record)
            head = Head(head.lab, at.position, record.hash, head.epoch, at.recorded_at)
        return records, head

    def write(self, batches: Sequence[Sequence[Entry]]) -> float:
        """Seconds that the commits of these batches took, one after the other."""
        prepared = []
        head = self.head
        for batch in batches:
            records, head = self.prepare(batch, head)
            prepared.append(records)
        began = time.perf_counter()
        for records in prepared:
            self.head = self.store.append(self.head, records)
        return time.perf_counter() - began


def three_commits(entries: Sequence[Entry], acceptance: Entry) -> list[list[Entry]]:
    """The events of one action in the batches that a careful kernel needs: what goes with the
    request, with the acceptance, with the result. A result may have overtaken the acceptance."""
    request = [e for e in entries if e.position <= position_of(entries, ActionRequested)]
    result = [e for e in entries if e.position >= position_of(entries, ActionSucceeded)]
    return [request, [acceptance], result]


def position_of(entries: Sequence[Entry], kind: type[Event]) -> int:
    return next(entry.position for entry in entries if isinstance(entry.event, kind))


async def one_action(lab: IdleLab) -> tuple[float, list[Entry]]:
    """Seconds for a run of one action on an idle lab, and what it wrote."""
    await asyncio.sleep(0.01)  # the last one's acknowledgement is no part of this one
    lab.ends.batches.clear()
    wanted = lab.ends.actions + 1
    began = time.perf_counter()
    lab.submit(0, 1)
    await lab.ends.until(lambda: lab.ends.actions >= wanted)
    took = time.perf_counter() - began
    return took, [entry for batch in lab.ends.batches for entry in batch]


async def measure_in(folder: Path, rounds: int, actions: int) -> Report:
    ratios, ours, limits, answers = [], [], [], []
    bare = BareLog(folder)
    commits = overtaken = 0
    acceptance: Entry | None = None
    async with idle_lab(folder, 1) as lab:
        lab.keep_plans(1)
        for _ in range(5):
            await one_action(lab)
        for _ in range(rounds):
            mine, limit = [], []
            for _ in range(actions):
                took, entries = await one_action(lab)
                mine.append(took)
                commits += len(lab.ends.batches)
                heard = next((e for e in entries if isinstance(e.event, ActionAccepted)), None)
                overtaken += heard is None
                acceptance = heard or acceptance
                if acceptance is not None:
                    limit.append(bare.write(three_commits(entries, acceptance)) + MESSAGE_S)
                if heard is not None:
                    asked = next(e for e in entries if isinstance(e.event, ActionRequested))
                    answers.append((heard.record.head.recorded_at - asked.record.head.recorded_at) / 1e9)
            ours.append(median(mine))
            limits.append(median(limit))
            ratios.append(ours[-1] / limits[-1])
    bare.store.close()
    ratio = median(ratios)
    figure = Figure(
        "one durable action, no-op device, idle lab, p50",
        milliseconds(median(ours)),
        f"{milliseconds(median(limits))} (3 commits + 0.3 ms)",
        times(ratio),
        f"≤ {MUST} ×",
        ratio <= MUST,
    )
    notes = [
        f"ratios of {rounds} rounds of {actions}: {spread(ratios)}",
        f"commits per action {commits / (rounds * actions):.2f}; results that overtook their "
        f"acceptance {overtaken}; request decided to acceptance decided (commit, bus, journal sync, bus) "
        f"{milliseconds(median(answers)) if answers else '–'}",
    ]
    return Report([figure], notes)


def measure(rounds: int = 5, actions: int = 60) -> Report:
    with scratch("action") as folder:
        return asyncio.run(measure_in(folder, rounds, actions))


def smoke() -> Report:
    return measure(1, 3)
