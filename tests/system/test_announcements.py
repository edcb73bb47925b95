"""Committed events are heard on the bus, and they are the log's own bytes."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

from labos.bootstrap import descriptions, open_lab
from labos.bus import open_bus
from labos.settings import Settings
from labos.spec import find_spec, load_workcell


def test_committed_events_are_published(tmp_path: Path) -> None:
    async def listen() -> tuple[list[bytes], list[bytes]]:
        cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
        settings = Settings.make(tmp_path, speed=1000.0, simulate=True)
        async with open_lab(settings, nodes="none") as lab:
            bus = await open_bus(mode="client", connect=[lab.bus_endpoint])
            heard: list[bytes] = []
            enough = asyncio.Event()

            def note(key: str, payload: bytes) -> None:
                heard.append(payload)
                if len(heard) >= 3:
                    enough.set()

            handle = await bus.subscribe(f"labos/{lab.kernel.lab}/@events/station", note)
            await lab.apply(cell, declare=True)
            await asyncio.wait_for(enough.wait(), 20)
            handle.close()
            await bus.close()
            return heard, [record.envelope for record in lab.store.read()]

    heard, envelopes = asyncio.run(listen())
    assert all(json.loads(message)["envelope"]["type"] == "station.declared" for message in heard)
    assert all(any(envelope in message for envelope in envelopes) for message in heard)
