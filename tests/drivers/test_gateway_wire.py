"""Instruments behind the reference gateway, which is driven over real HTTP and killed for real."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown, WrongDevice
from labos.node import Node, Setup, World
from labos_drivers.biometra import Biometra
from labos_drivers.biometra.wire import BiometraOnWire
from labos_drivers.chemspeed import Chemspeed
from labos_drivers.chemspeed.wire import ChemspeedOnWire
from labos_drivers.gateway import driver as gateway_driver
from labos_drivers.gateway import server as gateway_server
from labos_drivers.gateway.wire import GatewayOnWire
from labos_drivers.hidex import Hidex
from labos_drivers.hidex.wire import HidexOnWire
from labos_drivers.solo import Solo, protocol
from labos_drivers.solo.wire import SoloOnWire
from tests.drivers.test_ot2_wire import keep_handles
from tests.drivers.wires import at_port, run, setup_of, until

HSO = "\r\n".join(
    ["Empty"] * 7 + ["Plate", "GetTip", "Position1", "!@#$", "ShuckTip", "TipDisposal", "!@#$", ""]
)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The instruments live some thousand times as fast as real ones."""
    monkeypatch.setattr(gateway_driver, "POLL_S", 0.01)


@contextmanager
def behind(
    kind: type[GatewayOnWire[Any]], name: str, world: World, *, pace: float = 20_000
) -> Iterator[GatewayOnWire[Any]]:
    device = kind(setup_of(name, world, pace))
    device.start()
    try:
        yield device
    finally:
        device.close()


@asynccontextmanager
async def drive(driver: type[Node], name: str, url: str) -> AsyncIterator[Any]:
    node = at_port(driver, name, url, key="url")
    await node.connect()
    try:
        yield node
    finally:
        await node.close()


@pytest.fixture
def cycler(world: World) -> Iterator[GatewayOnWire[Any]]:
    with behind(BiometraOnWire, "biometra", world) as device:
        yield device


# -- the four instruments ----------------------------------------------------------------------


def test_a_plate_is_cycled(cycler: GatewayOnWire[Any], world: World) -> None:
    (plate,) = world.stock("biometra.default", "plate")

    async def body() -> None:
        handles = keep_handles()
        async with drive(Biometra, "biometra", cycler.address) as node:
            with pytest.raises(DeviceError, match="the lid is open") as told:
                await node.run_program(7)
            assert told.value.effects == "none"
            await node.close_lid()
            assert await node.observe() == {"lid": "closed"}
            await node.run_program(7)
            await node.open_lid()
            with pytest.raises(DeviceError, match="no program 1000"):
                await node.run_program(1000)
            assert await node.is_idle()
        assert len(set(handles)) == 4

    run(body)
    assert [(m.plate, m.facts) for m in world.motions("cycle")] == [(plate, {"program": 7})]


def test_a_plate_is_read(world: World) -> None:
    world.stock("hidex.default", "plate")

    async def body(url: str) -> None:
        async with drive(Hidex, "hidex", url) as node:
            await node.close_lid()
            assert re.fullmatch(r"growth_\d+\.csv", await node.run_assay("growth"))
            table = await node.read_plate("growth")
            assert (table["unit"], len(table["wells"])) == ("OD", 96)
            with pytest.raises(DeviceError, match="no name of an assay") as told:
                await node.run_assay("a\nb")
            assert told.value.effects == "none"

    with behind(HidexOnWire, "hidex", world) as device:
        run(lambda: body(device.address))
    assert len(world.motions("read")) == 2


def test_samples_are_made(world: World) -> None:
    async def body(url: str) -> None:
        async with drive(Chemspeed, "chemspeed", url) as node:
            await node.close_lid()
            await node.run_program("closed_loop1")
            with pytest.raises(DeviceError, match="no name of a program") as told:
                await node.run_program("../closed_loop1")
            assert told.value.effects == "none"

    with behind(ChemspeedOnWire, "chemspeed", world) as device:
        run(lambda: body(device.address))
    assert [m.facts for m in world.motions("synthesise")] == [{"program": "closed_loop1"}]


def test_a_protocol_file_goes_to_the_gateway(world: World, tmp_path: Path) -> None:
    world.stock("solo.Position4", "plate")
    (tmp_path / "mix.hso").write_bytes(HSO.encode())

    async def body(device: GatewayOnWire[Any]) -> None:
        async with drive(Solo, "solo", device.address) as node:
            await node.run_protocol(str(tmp_path / "mix.hso"))
            assert device.device.given == HSO
            with pytest.raises(DeviceError, match="there is no such file") as told:
                await node.run_protocol(str(tmp_path / "none.hso"))
            assert told.value.effects == "none"

    with behind(SoloOnWire, "solo", world) as device:
        run(lambda: body(device))
    assert [m.facts for m in world.motions("pipette")] == [{"protocol": "mix.hso"}]


def test_a_simulated_handler_takes_no_longer_protocol_than_a_real_one(world: World, tmp_path: Path) -> None:
    world.stock("solo.Position4", "plate")
    steps = f"GetTip\r\n{protocol.STEP_END}\r\n" * (protocol.MOST_STEPS + 1)
    (tmp_path / "long.hso").write_bytes(("Empty\r\n" * protocol.POSITIONS + steps).encode())

    async def body() -> None:
        node = Solo(Setup("solo", "w", world=world, pace=1e6))
        await node.connect()
        with pytest.raises(DeviceError, match="70 steps, and the program crashes beyond 69") as told:
            await node.run_protocol(str(tmp_path / "long.hso"))
        assert told.value.effects == "none"

    run(body)
    assert world.motions("pipette") == []


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (HSO, ""),
        (HSO.replace("\r\n", "\n"), "carriage return"),
        ("Empty\r\n" * 8, "no 8 positions and steps"),
        (HSO.replace("GetTip", "Explode"), "'Explode' is no step"),
        (HSO + "Aspirate\r\n", "no end"),
        ("Empty\r\n" * 8 + "GetTip\r\n!@#$\r\n" * 70, "70 steps"),
    ],
)
def test_what_solosoft_would_not_open_is_not_sent(text: str, why: str) -> None:
    found = protocol.find_flaw(text)
    assert why in found
    assert bool(why) == bool(found)


# -- busy, stopped, lost -----------------------------------------------------------------------


def test_an_id_is_started_once(cycler: GatewayOnWire[Any], world: World) -> None:
    with httpx.Client(base_url=cycler.address) as client:
        order = {"action": "close_lid"}
        assert client.put("/actions/a1", json=order).status_code == 201
        while client.get("/actions/a1").json()["status"] == "running":
            time.sleep(0.01)
        again = client.put("/actions/a1", json=order)
        assert (again.status_code, again.json()["status"]) == (200, "succeeded")
        assert client.delete("/actions/a3").json()["status"] == "void"
        assert client.put("/actions/a3", json=order).json()["status"] == "void"
        assert client.delete("/actions/a1").json()["status"] == "succeeded"
        assert client.put("/actions/a4", json={"action": "dance"}).status_code == 422
        assert client.put("/actions/..%2Fa", json=order).status_code == 422
        assert client.put("/actions/a5", content=b"[").status_code == 422
        assert client.get("/actions/a9").status_code == 404
        assert client.get("/actions/a1/files/..%2F..%2Fjournal.jsonl").status_code == 404
        assert client.get("/actions/a1/files/none.csv").status_code == 404
        assert client.get("/nothing").status_code == 404
    assert len(world.motions("shut")) == 1


def test_busy_and_stopped(world: World) -> None:
    world.stock("biometra.default", "plate")

    async def body(device: GatewayOnWire[Any]) -> None:
        async with drive(Biometra, "biometra", device.address) as node:
            await node.close_lid()
            work = asyncio.create_task(node.run_program(7))
            await until(lambda: bool(world.motions("heat")))
            assert not await node.is_idle()
            async with drive(Biometra, "other", device.address) as other:
                with pytest.raises(DeviceError, match="refused: the instrument is at work") as busy:
                    await other.open_lid()
                assert busy.value.effects == "none"
            await node.stop()
            with pytest.raises(DeviceError, match="stopped in mid-motion") as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(DeviceError, match="was stopped"):
                await node.open_lid()
            await node.reset()
            await node.open_lid()

    with behind(BiometraOnWire, "biometra", world, pace=1000) as device:
        run(lambda: body(device))


def test_a_crash_is_told(world: World) -> None:
    async def body(url: str) -> None:
        async with drive(Hidex, "hidex", url) as node:
            await node.close_lid()
            with pytest.raises(DeviceError, match="a plate that is not there") as told:
                await node.run_assay("growth")
            assert told.value.effects == "unknown"

    with behind(HidexOnWire, "hidex", world) as device:
        run(lambda: body(device.address))


class Between:
    """A cable between driver and gateway that may lose, spoil or hold back what goes through it."""

    def __init__(self, url: str) -> None:
        self.far = int(url.rpartition(":")[2])
        self.ask: Callable[[bytes], bytes | None] = lambda raw: raw
        self.tell: Callable[[bytes], bytes | None] = lambda raw: raw
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _serve(self) -> None:
        while True:
            try:
                near = self._listener.accept()[0]
            except OSError:
                return
            with near, socket.create_connection(("127.0.0.1", self.far)) as far:
                asked = self.ask(_message(near))
                if asked is None:
                    continue
                far.sendall(asked)
                told = self.tell(_message(far))
                if told is not None:
                    near.sendall(told)


def _message(line: socket.socket) -> bytes:
    raw = b""
    while b"\r\n\r\n" not in raw:
        piece = line.recv(65536)
        if not piece:
            return raw
        raw += piece
    head, _, body = raw.partition(b"\r\n\r\n")
    length = re.search(rb"(?i)content-length: (\d+)", head)
    while len(body) < (int(length[1]) if length else 0):
        body += line.recv(65536)
    return head + b"\r\n\r\n" + body


@pytest.mark.parametrize("reached", [True, False])
def test_a_start_whose_answer_is_lost_moves_once_or_never(
    cycler: GatewayOnWire[Any], world: World, reached: bool
) -> None:
    cable = Between(cycler.address)

    async def body() -> None:
        async with drive(Biometra, "biometra", cable.address) as node:
            if reached:
                cable.tell = once(cable, "tell")
                await node.close_lid()
                assert len(world.motions("shut")) == 1
                return
            held: list[bytes] = []
            cable.ask = once(cable, "ask", held)
            with pytest.raises(DeviceError, match="never heard of") as told:
                await node.close_lid()
            assert told.value.effects == "none"
            # What was held back comes at last, and moves nothing.
            with socket.create_connection(("127.0.0.1", cable.far)) as line:
                line.sendall(held[0])
                assert b'"void"' in _message(line)
            assert world.motions("shut") == []

    run(body)
    cable.close()


def once(cable: Between, which: str, held: list[bytes] | None = None) -> Callable[[bytes], None]:
    def lose(raw: bytes) -> None:
        if held is not None:
            held.append(raw)
        setattr(cable, which, lambda raw: raw)

    return lose


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda raw: raw[:-3], LinkError),
        (lambda raw: b"\x00\xff noise\r\n\r\n", LinkError),
        (lambda raw: re.sub(rb"(?s)\{.*\}", lambda m: b"[" + b" " * (len(m[0]) - 2) + b"]", raw), Garbled),
    ],
)
def test_spoilt_answers_are_no_answers(
    cycler: GatewayOnWire[Any], spoil: Callable[[bytes], bytes], error: type[LinkError]
) -> None:
    cable = Between(cycler.address)

    async def body() -> None:
        async with drive(Biometra, "biometra", cable.address) as node:
            cable.tell = spoil
            with pytest.raises(error):
                await node.is_idle()
            cable.tell = lambda raw: raw
            assert await node.is_idle()

    run(body)
    cable.close()


def test_unplugged_for_a_while_and_for_longer(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.stock("biometra.default", "plate")

    async def body(device: GatewayOnWire[Any]) -> None:
        handles = keep_handles()
        async with drive(Biometra, "biometra", device.address) as node:
            await node.close_lid()
            work = asyncio.create_task(node.run_program(7))
            await until(lambda: bool(world.motions("heat")))
            device.unplug()
            await asyncio.sleep(0.1)  # so long it is out of reach
            device.plug()
            device.start()
            await work
            monkeypatch.setattr(gateway_driver, "LOST_S", 0.2)
            work = asyncio.create_task(node.run_program(8))
            await until(lambda: len(world.motions("heat")) == 2)
            device.unplug()
            with pytest.raises(LinkError) as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(NotConnected) as gone:
                await node.open_lid()
            assert gone.value.effects == "none"
            device.plug()
            device.start()
        async with drive(Biometra, "biometra", device.address) as node:
            await node.take_up("run_program", handles[2])
            journal = handles[0].partition(":")[0]
            with pytest.raises(DeviceError, match="never heard of") as never:
                await node.take_up("open_lid", f"{journal}:another")
            assert never.value.effects == "none"
            with pytest.raises(DeviceError, match="nothing was started"):
                await node.take_up("open_lid", "")
            with pytest.raises(OutcomeUnknown):
                await node.take_up("reset", "x")

    with behind(BiometraOnWire, "biometra", world, pace=5000) as device:
        run(lambda: body(device))
    assert len(world.motions("cycle")) == 2


def test_two_addresses_are_swapped(world: World) -> None:
    async def body(url: str) -> None:
        with pytest.raises(WrongDevice, match="a gateway to hidex was expected, but a gateway to chemspeed"):
            await at_port(Hidex, "hidex", url, key="url").connect()

    with behind(ChemspeedOnWire, "chemspeed", world) as device:
        run(lambda: body(device.address))


# -- the gateway as a process ------------------------------------------------------------------

HANDS = """\
import time
from gateway import Failed, Hands, Refused


class Slow(Hands):
    instrument = "biometra"
    actions = ("open_lid", "close_lid", "run_program")

    def check(self, action, args):
        if action == "run_program" and args["number"] == 13:
            raise Refused("there is no program 13", "Name another one.")

    def do(self, action, args, folder):
        if action == "run_program":
            time.sleep(600)
        if action == "open_lid":
            raise Failed("the lid is stuck", "Look at it.", "partial")
        (folder / "log.txt").write_text("closed")

    def read_sensors(self):
        return {"lid": "closed"}
"""


@contextmanager
def gateway(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The reference gateway, copied by itself, with somebody's own hands."""
    (folder / "gateway.py").write_text(Path(gateway_server.__file__).read_text())
    (folder / "slow.py").write_text(HANDS)
    process = subprocess.Popen(
        [sys.executable, "gateway.py", "slow:Slow", "--port", "0", "--journal", str(folder / "slow.jsonl")],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().split()[-1]
    finally:
        process.kill()
        process.wait(30)
        process.stdout.close()


def test_a_gateway_that_dies_does_not_guess(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gateway_driver, "LOST_S", 0.2)

    async def first(process: subprocess.Popen[str], url: str) -> str:
        handles = keep_handles()
        async with drive(Biometra, "biometra", url) as node:
            assert await node.observe() == {"lid": "closed"}
            await node.close_lid()
            async with httpx.AsyncClient(base_url=url) as client:
                name = handles[0].rpartition(":")[2]
                assert (await client.get(f"/actions/{name}/files/log.txt")).text == "closed"
            with pytest.raises(DeviceError, match="open_lid failed: the lid is stuck") as partly:
                await node.open_lid()
            assert partly.value.effects == "partial"
            with pytest.raises(DeviceError, match="refused: there is no program 13") as refused:
                await node.run_program(13)
            assert refused.value.effects == "none"
            work = asyncio.create_task(node.run_program(7))
            await until(lambda: '"run_program", "status": "running"' in journal.read_text())
            with pytest.raises(DeviceError, match="takes no stop"):
                await node.stop()
            process.kill()
            with pytest.raises(LinkError) as told:
                await work
            assert told.value.effects == "unknown"
            return handles[-1]

    async def second(url: str, handle: str) -> None:
        async with drive(Biometra, "biometra", url) as node:
            with pytest.raises(OutcomeUnknown, match="restarted in mid-action"):
                await node.take_up("run_program", handle)
            await node.close_lid()

    journal = tmp_path / "slow.jsonl"
    with gateway(tmp_path) as (process, url):
        handle = run(lambda: first(process, url))
    with journal.open("a") as file:
        file.write('{"id": "torn')
    with gateway(tmp_path) as (process, url):
        run(lambda: second(url, handle))
    assert json.loads(journal.read_text().splitlines()[-1])["status"] == "succeeded"


@pytest.mark.parametrize(
    ("driver", "kind", "name", "action", "args", "ends"),
    [
        (Biometra, BiometraOnWire, "biometra", "close_lid", (), None),
        (Hidex, HidexOnWire, "hidex", "run_assay", ("growth",), "growth_0001.csv"),
        (Biometra, BiometraOnWire, "biometra", "run_program", (7,), OutcomeUnknown),
    ],
)
def test_a_pc_that_restarts_looks_back(
    world: World, driver: type[Any], kind: type[Any], name: str, action: str, args: tuple[Any, ...], ends: Any
) -> None:
    """The instrument goes on meanwhile; its sensors, or its file, may show how it ended."""
    world.stock(f"{name}.default", "plate")

    async def body(device: GatewayOnWire[Any]) -> None:
        async with drive(driver, name, device.address) as node:
            if args:
                await node.close_lid()
            work = asyncio.create_task(getattr(node, action)(*args))
            await until(lambda: bool(device.device.moving))
            await asyncio.to_thread(device.restart_pc)
            if ends is OutcomeUnknown:
                with pytest.raises(OutcomeUnknown, match="nothing shows what became of run_program"):
                    await work
            else:
                assert await work == ends
            assert await node.is_idle()
            await node.open_lid()

    with behind(
        kind, name, world, pace={"run_program": 5000, "run_assay": 300, "close_lid": 20}[action]
    ) as device:
        run(lambda: body(device))


def test_a_lost_journal_is_not_taken_for_what_never_happened(world: World, tmp_path: Path) -> None:
    async def first(url: str) -> str:
        handles = keep_handles()
        async with drive(Biometra, "biometra", url) as node:
            await node.close_lid()
        return handles[0]

    async def second(url: str, handle: str) -> None:
        async with drive(Biometra, "biometra", url) as node:
            with pytest.raises(OutcomeUnknown, match="lost the journal"):
                await node.take_up("close_lid", handle)
            node.device._journal = "another"  # as if the disk had been changed meanwhile
            with pytest.raises(DeviceError, match="its journal is not the one") as told:
                await node.open_lid()
            assert told.value.effects == "none"
            await node.open_lid()

    with behind(BiometraOnWire, "biometra", world) as device:
        handle = run(lambda: first(device.address))
    with behind(BiometraOnWire, "biometra", world) as device:  # with another disk
        run(lambda: second(device.address, handle))
    assert len(world.motions("open")) == 1


@pytest.mark.parametrize(
    ("driver", "name"),
    [(Biometra, "biometra"), (Hidex, "hidex"), (Chemspeed, "chemspeed")],
)
def test_simulated_behind_its_wire(driver: type[Any], name: str, world: World) -> None:
    async def body() -> None:
        node = driver(setup_of(name, world, 20_000, wire=True))
        await node.connect()
        await node.close_lid()
        assert await node.observe() == {"lid": "closed"}
        await node.close()

    run(body)


def test_a_gateway_that_does_not_say_that_it_is_idle_is_not(
    cycler: GatewayOnWire[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    tell = gateway_server.Handler._send

    async def body() -> None:
        async with drive(Biometra, "biometra", cycler.address) as node:
            assert await node.is_idle()
            answers: list[dict[str, Any]] = [{}, {"busy": None}, {"busy": 0}, {"busy": "no"}]
            for said in answers:

                def tells(self: Any, status: int, _: Any, said: Any = said) -> None:
                    tell(self, status, said)

                monkeypatch.setattr(gateway_server.Handler, "_send", tells)
                assert not await node.is_idle()

    run(body)


def test_an_assay_that_leaves_no_file_is_not_done(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.stock("hidex.default", "plate")
    handles = keep_handles()

    async def leaves_nothing(self: Any, assay: str) -> None:
        pass

    monkeypatch.setattr(HidexOnWire.kind, "run_assay", leaves_nothing)

    async def body(url: str) -> None:
        async with drive(Hidex, "hidex", url) as node:
            await node.close_lid()
            with pytest.raises(Garbled, match="has ended without a file: 'None'") as told:
                await node.run_assay("growth")
            assert told.value.effects == "unknown"
            with pytest.raises(Garbled, match="has ended without a file"):
                await node.take_up("run_assay", handles[-1])

    with behind(HidexOnWire, "hidex", world) as device:
        run(lambda: body(device.address))
