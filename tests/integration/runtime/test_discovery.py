"""Who finds whom on a bus where anybody may show any key."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
import pytest

from labos.bootstrap import _node, open_lab
from labos.bootstrap._node import find_lab
from labos.bus import ZenohBus, open_bus
from labos.core.canonical import digest
from labos.core.decide.lab import ApplyWorkcell
from labos.core.ids import ModuleName
from labos.core.model import ModuleSpec, Workcell
from labos.errors import BadInput
from labos.node.protocol import Keys, SetupReply, SetupRequest
from labos.settings import Settings, free_port


@asynccontextmanager
async def two() -> AsyncIterator[tuple[ZenohBus, ZenohBus]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    hub = await open_bus(mode="router", listen=[endpoint])
    try:
        other = await open_bus(connect=[endpoint])
        try:
            yield hub, other
        finally:
            await other.close()
    finally:
        await hub.close()


@pytest.mark.parametrize("known", ["", "mine"])
@pytest.mark.parametrize("shown", [["mine"], ["theirs"], ["theirs", "mine"]])
def test_a_node_takes_no_other_lab_for_its_own(
    known: str, shown: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if known not in shown:
        monkeypatch.setattr(_node, "OWN_LAB_S", 0.5)  # it waits in vain

    async def main() -> None:
        async with two() as (hub, other):
            for lab in shown:
                await other.declare_alive(Keys(lab).kernel)
            await other.declare_alive("labos/a/b/@kernel")
            if known in shown or (not known and len(shown) == 1):
                assert await find_lab(hub, "cell/arm", known) == (known or shown[0])
            else:
                with pytest.raises(BadInput, match="belongs to the lab mine" if known else "Several labs"):
                    await find_lab(hub, "cell/arm", known)

    asyncio.run(main())


def test_setup_tells_of_the_module_asked_for_and_of_no_other(tmp_path: Path) -> None:
    modules = tuple(
        ModuleSpec(
            ModuleName(f"cell/{name}"),
            "driver",
            config={"config": {"password": f"secret of {name}"}, "interface": f"rest://{name}"},
        )
        for name in ("a", "b")
    )

    async def main() -> None:
        settings = Settings.make(tmp_path / "lab", simulate=True)
        async with open_lab(settings) as lab:
            cell = Workcell("cell", digest(b""), modules, ())
            await lab.kernel.execute(ApplyWorkcell(cell), "ada")
            bus = await open_bus(connect=[lab.bus_endpoint])

            async def list_told(payload: bytes) -> bytes:
                return await bus.query(Keys(lab.kernel.lab).setup, payload, 5.0)

            try:
                for name in ("a", "b"):
                    reply = await list_told(msgspec.json.encode(SetupRequest(f"cell/{name}")))
                    assert reply.count(b"secret of") == 1
                    assert f"secret of {name}".encode() in reply
                    assert reply.count(b"rest://") == 1
                odd = ["", "a", "cell/c", "cell/*", "**", "other/a", "cell/a/b", "x" * 100_000, "\x00"]
                asked = [msgspec.json.encode(SetupRequest(name)) for name in odd]
                for payload in [*asked, b"", b"{}", b"[" * 100_000, b'{"module": 1}', b"\xff", b'"\xff"']:
                    reply = msgspec.json.decode(await list_told(payload), type=SetupReply)
                    assert reply.unknown
                    assert len(reply.unknown) < 1000
                    assert reply == SetupReply(unknown=reply.unknown), "nothing else is told"
            finally:
                await bus.close()

    asyncio.run(main())
