"""Durable actions a second with 64 in flight.

The limit is the loop below: the same journals, store and bus, group commit by the same writer
thread, sealed records of the same kinds, and nothing else: no rules, no plan, no fold, no checks.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import msgspec

from labos.bus import ZenohBus
from labos.clock import Uuid7Ids
from labos.core.actions import ActionAccepted, ActionRequested, ActionSucceeded
from labos.core.canonical import digest
from labos.core.envelope import Envelope, Record, seal
from labos.core.ids import ActionId, LabId, RunId
from labos.core.registry import Event, encode
from labos.node.protocol import ResultPublished, Start
from labos.ports import Head
from labos.runtime.writer import ThreadWriter
from labos.store import open_store
from tests.benchmarks.figures import Figure, Report, median, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab, module_name
from tests.benchmarks.node_process import local_name

MUST = 0.5
_encode = msgspec.json.Encoder().encode
_result = msgspec.json.Decoder(ResultPublished)


class BareLoop:
    """Request, commit, send, acceptance, result, commit; the next request goes with the result."""

    def __init__(self, writer: ThreadWriter, head: Head, bus: ZenohBus) -> None:
        self.writer, self.head, self.bus = writer, head, bus
        self.ids = Uuid7Ids()
        self.waiting: list[tuple[int, asyncio.Future[None]]] = []
        self.results: dict[str, asyncio.Future[None]] = {}
        writer.begin(head, self._on_durable, lambda error: print(error))

    def write(self, *events: Event) -> int:
        """Seal events behind one another and pass them on; returns the last position."""
        records: list[Record] = []
        for event in events:
            payload = encode(event)
            position, now = self.head.position + 1, time.time_ns()
            envelope = Envelope(
                lab=self.head.lab,
                position=position,
                id=self.ids.new(),
                stream=event.stream(),
                version=position,
                type=event.TYPE,
                schema=event.SCHEMA,
                recorded_at=max(now, self.head.recorded_at),
                actor="labos",
                correlation=event.stream(),
                causation="",
                digest=digest(payload),
            )
            record = seal(self.head.hash, envelope, payload)
            self.head = Head(self.head.lab, position, record.hash, self.head.epoch, envelope.recorded_at)
            records.append(record)
        self.writer.submit(records)
        return self.head.position

    async def durable(self, position: int) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.waiting.append((position, future))
        await future

    def _on_durable(self, position: int) -> None:
        ready = [future for at, future in self.waiting if at <= position]
        self.waiting = [(at, future) for at, future in self.waiting if at > position]
        for future in ready:
            future.set_result(None)

    def on_result(self, key: str, payload: bytes) -> None:
        self.results.pop(_result.decode(payload).action).set_result(None)

    async def client(self, number: int, actions: int) -> None:
        """So many actions of one node, one after the other."""
        run, module, name = RunId(f"R{number}"), module_name(number), local_name(number)
        events: list[Event] = []
        for step in range(actions):
            action = ActionId(self.ids.new())
            events.append(ActionRequested(action, run, step, module, 1, 1, "journal", "act", {}, ()))
            position = self.write(*events)
            ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self.results[action] = ended
            await self.durable(position)
            start = Start(self.head.lab, 1, "journal", action, 1, position, "act")
            await self.bus.query(f"bare/{name}/action", _encode(start), 30.0)
            self.write(ActionAccepted(action, run, step, module, 1))
            await ended
            events = [ActionSucceeded(action, run, step, module, 1)]
        await self.durable(self.write(*events))


async def bare_rate(loop: BareLoop, modules: int, actions: int) -> float:
    began = time.perf_counter()
    await asyncio.gather(*(loop.client(number, actions) for number in range(modules)))
    return modules * actions / (time.perf_counter() - began)


async def our_rate(lab: IdleLab, actions: int) -> float:
    wanted = lab.ends.actions + lab.modules * actions
    began = time.perf_counter()
    for module in range(lab.modules):
        lab.submit(module, actions)
    await lab.ends.until(lambda: lab.ends.actions >= wanted, 120.0)
    return lab.modules * actions / (time.perf_counter() - began)


async def measure_in(folder: Path, rounds: int, modules: int, actions: int, processes: int) -> Report:
    ratios, ours, limits, commits = [], [], [], []
    store = open_store(f"sqlite:///{folder}/bare.db")
    writer = ThreadWriter(store)
    head = store.claim(LabId("bare"), "benchmark", 3600.0)
    async with idle_lab(folder, modules, processes) as lab:
        loop = BareLoop(writer, head, lab.bus)
        await lab.bus.subscribe("bare/*/result", loop.on_result)
        lab.keep_plans(actions)
        await bare_rate(loop, modules, 2)
        await our_rate(lab, 2)
        for _ in range(rounds):
            limits.append(await bare_rate(loop, modules, actions))
            lab.ends.batches.clear()
            ours.append(await our_rate(lab, actions))
            commits.append(len(lab.ends.batches) / (modules * actions))
            ratios.append(ours[-1] / limits[-1])
    await writer.close()
    store.close()
    ratio = median(ratios)
    figure = Figure(
        f"durable actions/s, {modules} in flight, node journals on",
        f"{median(ours):.0f}/s",
        f"{median(limits):.0f}/s (bare loop)",
        times(ratio),
        f"≥ {MUST} ×",
        ratio >= MUST,
    )
    notes = [
        f"ratios of {rounds} rounds of {modules} × {actions}: {spread(ratios)}",
        f"{processes} node process(es); commits per action {median(commits):.3f}",
    ]
    return Report([figure], notes)


def measure(rounds: int = 3, modules: int = 64, actions: int = 30, processes: int = 1) -> Report:
    with scratch("throughput") as folder:
        return asyncio.run(measure_in(folder, rounds, modules, actions, processes))


def smoke() -> Report:
    return measure(1, 3, 2)
