"""What must hold when a seed's day is over."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

from labos.core.actions import ActionDiscovered, ActionRequested
from labos.core.envelope import GENESIS, find_damage
from labos.core.lab import KernelStarted
from labos.core.registry import decode
from labos.core.shorter import LogFoundShorter
from labos.core.state import LabState, hash_state
from labos.errors import LabosError
from labos.node.journal import read_journal
from labos.ports import Handler
from labos.testing.bus import Network
from labos.testing.lab import SimulatedLab
from labos.testing.loop import Killed
from tests.simulation.stops import causes

ENDS = ("action.succeeded", "action.failed", "action.reconciled")


class Obedience:
    """Listens to what nodes answer: one that has obeyed a kernel never obeys an older one."""

    def __init__(self, network: Network) -> None:
        self.wrong: list[str] = []
        self.fenced = 0
        self._highest: dict[str, int] = {}
        network.serve_with = self._serve

    async def _serve(self, key: str, handler: Handler, payload: bytes) -> bytes:
        if not key.endswith("/action"):
            return await handler(payload)
        epoch = int(json.loads(payload)["epoch"])
        highest = self._highest.get(key, 0)
        reply = await handler(payload)
        status = json.loads(reply)["status"]
        if status == "fenced":
            self.fenced += 1
        else:
            self._highest[key] = max(epoch, self._highest.get(key, 0))
            if epoch < highest:
                self.wrong.append(f"{key} obeyed epoch {epoch} after {highest}: {status}")
        return reply


def findings(lab: SimulatedLab, state: LabState, obedience: Obedience) -> list[str]:
    """What does not hold, each with the name of the check that says so; empty if all does."""
    found = [f"bench: {line}" for line in lab.differences(state)]
    found += [f"chain: {line}" for line in chain(lab)]
    found += [f"epochs: {line}" for line in epochs(lab)]
    found += [f"once: {line}" for line in once(lab)]
    found += [f"refold: {line}" for line in refold(lab, state)]
    found += [f"rules: {fault}" for kernel in lab.opened for fault in kernel.faults]
    found += [f"surprise: {line}" for line in surprises(lab)]
    found += [f"fence: {line}" for line in obedience.wrong]
    found += [f"lease: {name} was replaced while it worked" for name in lab.store.usurped]
    found += [f"end: {line}" for line in list_hanging(lab, state)]
    return found


def chain(lab: SimulatedLab) -> Iterator[str]:
    """Gapless, linked, and recorded-at never goes back."""
    previous, position, recorded_at = GENESIS, 0, 0
    for record in lab.store.records:
        fault = find_damage(previous, record)
        if fault:
            yield f"{record.head.position}: {fault}"
        if record.head.position != position + 1:
            yield f"{record.head.position} follows {position}"
        if record.head.recorded_at < recorded_at:
            yield f"{record.head.position} was recorded before the one before it"
        previous, position, recorded_at = record.hash, record.head.position, record.head.recorded_at


def epochs(lab: SimulatedLab) -> Iterator[str]:
    """Epochs only rise, and nobody has written a request after a successor had begun."""
    epoch = 0
    for record in lab.store.records:
        if record.head.type not in (KernelStarted.TYPE, ActionRequested.TYPE):
            continue
        event: Any = decode(record.head.type, record.head.schema, record.payload)
        if isinstance(event, ActionRequested) and event.epoch != epoch:
            yield f"{record.head.position}: requested in epoch {event.epoch}, after epoch {epoch} had begun"
        elif isinstance(event, KernelStarted):
            if event.epoch <= epoch:
                yield f"{record.head.position}: epoch {event.epoch} follows {epoch}"
            epoch = event.epoch


def once(lab: SimulatedLab) -> Iterator[str]:
    """Each action is asked for before anybody does it, and ends once."""
    ends: Counter[str] = Counter()
    asked: set[str] = set()
    for record in lab.store.records:
        if not record.head.type.startswith(("action.", "log.")):
            continue
        event: Any = decode(record.head.type, record.head.schema, record.payload)
        if isinstance(event, ActionRequested):
            asked.add(event.action)
        elif isinstance(event, ActionDiscovered):
            yield f"{event.module} did {event.action}, of which the log knew nothing"
        elif isinstance(event, LogFoundShorter):
            yield f"{event.evidence} {event.knows}, and nobody has cut the log"
        elif record.head.type in ENDS:
            ends[event.action] += 1
    for action, count in ends.items():
        if count > 1:
            yield f"{action} ended {count} times"
    for name, data in lab.disk.items():
        for attempt in read_journal(data).list_attempts():
            if attempt.action not in asked:
                yield f"the journal of {name} holds {attempt.action}, which nobody asked for"


def refold(lab: SimulatedLab, state: LabState) -> Iterator[str]:
    """What the kernel has in memory is what the log amounts to."""
    if not lab.remembered:
        yield f"the day did not end: {lab.report()}"
    elif lab.remembered != hash_state(state):
        yield "the kernel's state is not that of the log"


def surprises(lab: SimulatedLab) -> Iterator[str]:
    """Errors that nobody expected, in any process."""
    for process in lab.processes:
        for task in process.tasks:
            if not task.done() or task.cancelled():
                continue
            error = task.exception()
            if error is not None and not isinstance(error, Killed | LabosError):
                yield f"{process.name}: {error!r}"


def list_hanging(lab: SimulatedLab, state: LabState) -> Iterator[str]:
    """Runs that have not ended although nobody is asked about them."""
    left = [*state.runs.active.values(), *state.runs.queued.values()]
    for run, stops in causes(state, left, lab.store.head().recorded_at).items():
        if not any(stop.startswith("person") for stop in stops):
            yield f"{run} has not ended, and no person is asked: {lab.report()}"
