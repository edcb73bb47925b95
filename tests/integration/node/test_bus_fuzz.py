"""Thousands of messages that no kernel would send, to a real node over a real bus."""

from __future__ import annotations

import random
import time
from collections import Counter
from typing import Any

import msgspec
import pytest

from labos.clock import Uuid7Ids
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.limits import MESSAGE_LIMIT
from labos.node.protocol import (
    EPOCH_JUMP,
    GREATEST,
    POSITION_JUMP,
    AboutReport,
    Acknowledge,
    ActionReply,
    AdminReply,
    AdminRequest,
    Ask,
    ResourcesReport,
    Start,
    StateReport,
)
from labos.node.server import NodeServer
from tests.integration.node.bench import LAB, MODULE, Arm, Bench, nest
from tests.integration.node.test_node_server import Check, check
from tests.unit.node.test_journal_fold import memory, restart

__all__ = ["check"]

ANSWERS: dict[str, Any] = {
    "about": AboutReport,
    "action": ActionReply,
    "reset": ActionReply,
    "resources": ResourcesReport,
    "state": StateReport,
    "admin": AdminReply,
}
NUMBERS = (0, 1, -1, 2, 7, 10**6, EPOCH_JUMP, POSITION_JUMP + 1, GREATEST, GREATEST + 1, 2**62, 2**63, 2**64)
WORDS = ("", "a1", "a/b", "**", "x" * 500, "\u0000", "ä☃", "../../etc/passwd", "a\nb", "lab7", "wave", "nest")
COMMANDS = (
    "stop",
    "estop",
    "observe",
    "shutdown",
    "settled",
    "rewind",
    "trace",
    "dance",
    "",
)
ACTIONS = (
    "wave",
    "wave",
    "home",
    "home",
    "look",
    "wait",
    "pick",
    "look",
    "with_handle",
    "fail",
    "reset",
    "fly",
    "",
)
HOWS = ("device", "harmless", "surprise", "nan", "integer", "surrogate", "deep", "long words", "mute")


class Fuzz:
    """Messages from one seed."""

    def __init__(self, seed: int, journal: Journal) -> None:
        self.rng = random.Random(seed)
        self.journal = journal

    def message(self) -> tuple[str, bytes]:
        """An operation, and what it is sent."""
        operation = self.rng.choice([*ANSWERS, *["action"] * 6, "admin"])
        kind = self.rng.choice(["plain"] * 4 + ["odd", "odd", "odd", "bytes", "json", "large"])
        if kind == "json":
            return operation, msgspec.json.encode(self.value())
        if kind == "large":
            return operation, self.rng.choice(
                [b"[" * 90_000, b'{"op":"start",' + b" " * MESSAGE_LIMIT, b"\xff"]
            )
        message = self.build_request(operation, odd=kind == "odd")
        payload = msgspec.json.encode(message)
        if kind == "bytes":
            data = bytearray(payload)
            for _ in range(self.rng.randint(1, 4)):
                data[self.rng.randrange(len(data))] = self.rng.randrange(256)
            payload = bytes(data)
        return operation, payload

    def build_request(self, operation: str, *, odd: bool) -> dict[str, Any]:
        name = self.rng.choice(ACTIONS)
        args: dict[str, Any] = {"how": self.rng.choice(HOWS)} if name == "fail" else {}
        action, attempt = f"a{self.rng.randint(1, 400)}", self.rng.randint(1, 3)
        # As a kernel counts on, whatever the messages before have done: else all would be fenced soon.
        epoch, position = (
            self.journal.memory.epoch or 1,
            self.journal.memory.pruned + self.rng.randint(-2, 40),
        )
        start = Start(LAB, epoch, self.journal.memory.id, action, attempt, position, name, args)
        message: Any = self.rng.choice(
            [
                start,
                start,
                start,
                Ask(LAB, epoch, action, attempt, position, self.rng.random() < 0.5),
                Acknowledge(LAB, epoch, position - 30),
            ]
        )
        if operation == "admin":
            given = {"action": action, "done": True, "position": position, "by": "ada"}
            message = AdminRequest(LAB, epoch, self.rng.choice(COMMANDS), given)
        fields: dict[str, Any] = msgspec.to_builtins(message)
        if odd:
            for field in self.rng.sample(sorted(fields), self.rng.randint(1, 3)):
                fields[field] = self.value()
            if isinstance(fields.get("args"), dict):
                fields["args"][self.rng.choice(["by", "position", "done", "x"])] = self.value()
        return fields

    def value(self) -> Any:
        return self.rng.choice(
            [
                self.rng.choice(NUMBERS),
                self.rng.choice(WORDS),
                self.rng.choice([None, True, 1.5, -0.0, 1e300]),
                nest(self.rng.choice([1, 49, 60, 400])),
                {self.rng.choice(WORDS): self.rng.choice(NUMBERS)},
            ]
        )


def ready(arm: Arm) -> None:
    arm.go.set()


async def fuzz(here: Bench, seed: int, count: int) -> NodeServer:
    server = await here.node(prepare=ready)
    source = Fuzz(seed, server.journal)
    keys, told = here.kernel.keys, Counter[str]()
    for number in range(count):
        if number % 8 == 7:
            await bring_back(here, server)
        operation, payload = source.message()
        answer = await here.kernel.bus.query(keys.operation(MODULE, operation), payload, 10.0)
        reply = msgspec.json.decode(answer, type=ANSWERS[operation])
        told[getattr(reply, "status", operation) if operation in ("action", "reset") else operation] += 1
    print(f"seed {seed}: {dict(told)}, {len(server.journal.memory.list_attempts())} attempts in the journal")
    assert not server.journal.broken
    assert told["finished"] + told["accepted"] > count / 20  # else it was no trial
    return server


async def bring_back(here: Bench, server: NodeServer) -> None:
    """Out of what the messages have done to it: stopped, told of a position far ahead."""
    kernel = here.kernel
    kernel.epoch = server.journal.memory.epoch
    assert (await kernel.admin("rewind", position=min(server.journal.memory.pruned, 10**9))).done
    server.stopping.clear()
    recovery = f"r{server.journal.memory.pruned}.{kernel.epoch}.{time.monotonic_ns()}"
    start = Start(LAB, kernel.epoch, kernel.journal, recovery, 1, server.journal.memory.pruned + 1, "reset")
    reply = await kernel.bus.query(kernel.keys.operation(MODULE, "reset"), msgspec.json.encode(start), 5.0)
    assert msgspec.json.decode(reply, type=ActionReply).status in ("finished", "accepted"), reply


async def works_still(here: Bench) -> None:
    """A journal that remembers the same, and a module that works."""
    server = await here.node()
    await bring_back(here, server)
    kernel, before = here.kernel, len(here.world.motions("wave"))
    start = Start(LAB, kernel.epoch, kernel.journal, "last", 1, server.journal.memory.pruned + 1, "wave")
    assert (await kernel.send(start)).status == "finished"
    assert len(here.world.motions("wave")) == before + 1


async def campaign(here: Bench, seed: int, count: int) -> None:
    server = await fuzz(here, seed, count)
    await server.close()
    kept = restart(memory(server.journal))
    journal = await Journal.open(FileJournalFile(here.folder / "arm.journal"), Uuid7Ids())
    assert journal.memory == kept
    await journal.close()
    await works_still(here)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_node_answers_whatever_it_is_sent(check: Check, seed: int) -> None:
    async def scenario(here: Bench) -> None:
        await campaign(here, seed, 100)

    check(scenario)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(10, 20))
def test_a_node_answers_whatever_it_is_sent_at_length(check: Check, seed: int) -> None:
    async def scenario(here: Bench) -> None:
        await campaign(here, seed, 250)

    check(scenario)
