"""The bare limits: what the same disk, journals and bus allow without rules, plans and folds."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
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
from labos.runtime.ledger import Entry
from labos.runtime.writer import ThreadWriter
from labos.store import SqlEventStore, open_store
from tests.benchmarks.idle_lab import module_name
from tests.benchmarks.node_process import local_name

_encode = msgspec.json.Encoder().encode
_result = msgspec.json.Decoder(ResultPublished)


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

    def write(self, batches: Sequence[Sequence[Entry]], pause_s: float = 0.0) -> float:
        """Seconds that the commits of these batches took, each after a pause that is not counted."""
        prepared = []
        head = self.head
        for batch in batches:
            records, head = self.prepare(batch, head)
            prepared.append(records)
        took = 0.0
        for records in prepared:
            if pause_s:
                time.sleep(pause_s)
            began = time.perf_counter()
            self.head = self.store.append(self.head, records)
            took += time.perf_counter() - began
        return took


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


@asynccontextmanager
async def bare_loop(folder: Path, bus: ZenohBus) -> AsyncIterator[BareLoop]:
    """A loop over a log of its own, to the bare nodes on this bus."""
    store = open_store(f"sqlite:///{folder}/loop.db")
    writer = ThreadWriter(store)
    loop = BareLoop(writer, store.claim(LabId("loop"), "benchmark", 3600.0), bus)
    await bus.subscribe("bare/*/result", loop.on_result)
    yield loop
    await writer.close()
    store.close()
