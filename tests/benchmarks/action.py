"""One durable action: from the start of its step until its result is on disk.

It is judged beside the bare loop: the same commits, messages and journal, and no kernel (decision 6).
Shown too is three commits (request, acceptance, result) of the very batches that LabOS wrote, to a
second log of the same kind beside it, and 0.3 ms for a message there and back.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from pathlib import Path

from msgspec.structs import replace

from labos.core.actions import ActionAccepted, ActionRequested, ActionSucceeded
from labos.core.canonical import digest
from labos.core.envelope import seal
from labos.core.registry import Event, encode
from labos.runtime.ledger import Entry
from tests.benchmarks.bare import BareLog, bare_loop
from tests.benchmarks.figures import Figure, Report, median, milliseconds, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab

MESSAGE_S = 0.0003
PAUSE_S = 0.01
MUST = 1.5


def three_commits(entries: Sequence[Entry]) -> list[list[Entry]]:
    """The events of one action in the batches that a careful kernel needs: what goes with the
    request, with the acceptance, with the result. An action that was over at once has none of the
    second; it is made up then."""
    asked, ended = find(entries, ActionRequested), find(entries, ActionSucceeded)
    request = [entry for entry in entries if entry.position <= asked.position]
    result = [entry for entry in entries if entry.position >= ended.position]
    return [request, [find_acceptance(asked)], result]


def find_acceptance(asked: Entry) -> Entry:
    """The acceptance of a request."""
    request = asked.event
    assert isinstance(request, ActionRequested)
    event = ActionAccepted(request.action, request.run, request.step, request.module, request.attempt)
    payload = encode(event)
    head = replace(asked.record.head, type=event.TYPE, schema=event.SCHEMA, digest=digest(payload))
    return Entry(seal(asked.record.hash, head, payload), event)


def find(entries: Sequence[Entry], kind: type[Event]) -> Entry:
    return next(entry for entry in entries if isinstance(entry.event, kind))


async def one_action(lab: IdleLab) -> tuple[float, list[Entry]]:
    """Seconds for a run of one action on an idle lab, and what it wrote."""
    await asyncio.sleep(PAUSE_S)  # the last one's acknowledgement is no part of this one
    lab.ends.batches.clear()
    wanted = lab.ends.actions + 1
    began = time.perf_counter()
    lab.submit(0, 1)
    await lab.ends.until(lambda: lab.ends.actions >= wanted)
    took = time.perf_counter() - began
    return took, [entry for batch in lab.ends.batches for entry in batch]


async def measure_in(folder: Path, rounds: int, actions: int) -> Report:
    ratios, ours, limits, paused, answers, paths, beside = [], [], [], [], [], [], []
    bare = BareLog(folder)
    commits = at_once = 0
    async with idle_lab(folder, 1) as lab, bare_loop(folder, lab.bus) as loop:
        lab.keep_plans(1)
        for _ in range(5):
            await one_action(lab)
            await loop.client(0, 1)
        for _ in range(rounds):
            mine, limit, path = [], [], []
            for number in range(actions):
                took, entries = await one_action(lab)
                mine.append(took)
                await asyncio.sleep(PAUSE_S)  # the bare loop is as idle as we were
                began = time.perf_counter()
                await loop.client(0, 1)
                path.append(time.perf_counter() - began)
                commits += len(lab.ends.batches)
                at_once += not any(isinstance(entry.event, ActionAccepted) for entry in entries)
                limit.append(bare.write(three_commits(entries)) + MESSAGE_S)
                if number % 4 == 0:
                    paused.append(bare.write(three_commits(entries), PAUSE_S) + MESSAGE_S)
                asked, ended = find(entries, ActionRequested), find(entries, ActionSucceeded)
                answers.append((ended.record.head.recorded_at - asked.record.head.recorded_at) / 1e9)
            ours.append(median(mine))
            limits.append(median(limit))
            paths.append(median(path))
            beside.append(ours[-1] / paths[-1])
            ratios.append(ours[-1] / limits[-1])
    bare.store.close()
    ratio = median(ratios)
    figure = Figure(
        "one durable action, no-op device, idle lab, p50",
        milliseconds(median(ours)),
        f"{milliseconds(median(limits))} (3 commits + 0.3 ms)",
        times(ratio),
    )
    path_figure = Figure(
        "the same beside the bare loop with one in flight",
        milliseconds(median(ours)),
        f"{milliseconds(median(paths))} (no kernel)",
        times(median(beside)),
        f"≤ {MUST} ×",
        median(beside) <= MUST,
    )
    notes = [
        f"ratios of {rounds} rounds of {actions}: {spread(ratios)}; of the bare loop to the limit: "
        f"{spread([path / limit for path, limit in zip(paths, limits, strict=True)])}",
        f"beyond the limit {milliseconds(median(ours) - median(limits))}: a fixed cost (bus, journal, "
        f"threads, kernel), {milliseconds(median(paths) - median(limits))} of it the bare loop's too",
        f"the limit with commits that each follow a pause of {PAUSE_S * 1e3:.0f} ms, as on an idle lab: "
        f"{milliseconds(median(paused))}; ours beside it {times(median(ours) / median(paused))}",
        f"commits per action {commits / (rounds * actions):.2f}; over at once, without an acceptance of "
        f"their own, {at_once}; request decided to result decided (commit, bus, journal sync, bus) "
        f"{milliseconds(median(answers))}",
    ]
    return Report([figure, path_figure], notes)


def measure(rounds: int = 5, actions: int = 60) -> Report:
    with scratch("action") as folder:
        return asyncio.run(measure_in(folder, rounds, actions))


def smoke() -> Report:
    return measure(1, 3)
