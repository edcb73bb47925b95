"""What the kernel answers to nodes that ask for their settings and for files, over the bus."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec

from labos.bootstrap import LabRuntime, descriptions, open_lab
from labos.bus import open_bus
from labos.node.limits import MESSAGE_LIMIT, REPLY_LIMIT
from labos.node.protocol import FetchFile, FileReply, KeepFile, Keys, SetupReply, SetupRequest
from labos.ports import Bus
from labos.settings import Settings
from labos.spec import load_workcell

CELL = """
labos: 1
name: corner
modules:
  - {name: pf400, model: pf400, config: {clumsy: 0.25, read_secret: pf400}}
  - {name: eye, model: camera, config: {reads: true, read_secret: eye}}
stations: {wc.a: {kind: nest}, wc.b: {kind: nest}}
stock: {wc.a: {plate96: 1}}
"""


def with_lab(tmp_path: Path, scenario: Callable[[LabRuntime, Bus], Awaitable[None]]) -> None:
    async def main() -> None:
        file = tmp_path / "corner.yaml"
        file.write_text(CELL)
        cell = load_workcell(file, descriptions())
        settings = Settings.make(tmp_path / "home", speed=1000.0, simulate=True)
        async with open_lab(settings, nodes="none") as lab:
            await lab.apply(cell, declare=True)
            bus = await open_bus(mode="client", connect=[lab.bus_endpoint])
            try:
                await scenario(lab, bus)
            finally:
                await bus.close()

    asyncio.run(main())


def test_a_node_is_told_of_its_own_module_only(tmp_path: Path) -> None:
    async def scenario(lab: LabRuntime, bus: Bus) -> None:
        key = Keys(lab.kernel.lab).setup
        for mine, other in (("pf400", "eye"), ("eye", "pf400")):
            answer = await bus.query(key, msgspec.json.encode(SetupRequest(f"corner/{mine}")), 5.0)
            told = msgspec.json.decode(answer, type=SetupReply)
            assert told.config["read_secret"] == mine
            assert other.encode() not in answer
        for name in ("", "corner", "corner/*", "**", "other/eye", "x" * 100_000):
            answer = await bus.query(key, msgspec.json.encode(SetupRequest(name)), 5.0)
            told = msgspec.json.decode(answer, type=SetupReply)
            assert told.unknown
            assert len(answer) < 2_000
            assert told.config == {}

    with_lab(tmp_path, scenario)


def test_whatever_is_asked_is_answered(tmp_path: Path) -> None:
    rng = random.Random(1)

    def odd() -> Any:
        return rng.choice([None, 0, -1, 2**70, "", "\u0000", "x" * 500, [], {}, True, "0" * 64, 1.5])

    def payload(plain: list[msgspec.Struct]) -> bytes:
        data = bytearray(msgspec.json.encode(rng.choice(plain)))
        match rng.randrange(5):
            case 0:
                fields = msgspec.json.decode(bytes(data))
                fields[rng.choice(sorted(fields))] = odd()
                return msgspec.json.encode(fields)
            case 1:
                data[rng.randrange(len(data))] = rng.randrange(256)
            case 2:
                return rng.choice([b"[" * 50_000, b"", b"\xff\xfe", b'{"module":"\xff"}', b"9" * 6_000])
            case 3:
                return data + b" " * rng.choice([MESSAGE_LIMIT, REPLY_LIMIT])
            case _:
                pass
        return bytes(data)

    async def scenario(lab: LabRuntime, bus: Bus) -> None:
        keys, digest = Keys(lab.kernel.lab), "ab" * 32
        for _ in range(100):
            plain: list[msgspec.Struct] = [SetupRequest("corner/eye")]
            answer = await bus.query(keys.setup, payload(plain), 5.0)
            assert msgspec.json.decode(answer, type=SetupReply)
            plain = [FetchFile(digest, 0), KeepFile(digest, 3, 0, b"abc"), KeepFile(digest, 9, 0, b"abc")]
            answer = await bus.query(keys.files, payload(plain), 5.0)
            assert msgspec.json.decode(answer, type=FileReply)

    with_lab(tmp_path, scenario)
