"""The OT-2 driver and a simulated OT-2 behind its robot server."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.errors import BadInput, DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown, WrongDevice
from labos.node import World
from labos.node.node import handle_keeper
from labos_drivers._onhttp import HttpEnd, OnHttp, Reply, Request
from labos_drivers.ot2 import OT2, protocol
from labos_drivers.ot2 import driver as ot2_driver
from labos_drivers.ot2.software import VARIABLE
from labos_drivers.ot2.wire import MOST_PROTOCOLS, Disk, OT2OnWire
from tests.drivers.wires import at_port, power_on, run, setup_of, until

PROTOCOL = 'metadata = {"apiLevel": "2.12"}\n\n\ndef run(protocol):\n    print(LABOS["destination_wells"])\n'
HEADERS = {"Opentrons-Version": "3"}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot lives a few thousand times as fast as a real one."""
    monkeypatch.setattr(ot2_driver, "POLL_S", 0.01)
    monkeypatch.delenv(VARIABLE, raising=False)


@pytest.fixture
def robot(world: World) -> Iterator[OT2OnWire]:
    with power_on(OT2OnWire, "ot2", world, pace=4000) as device:
        yield device


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "mix.py"
    path.write_text(PROTOCOL)
    return str(path)


@asynccontextmanager
async def drive(robot: OnHttp) -> AsyncIterator[OT2]:
    node = at_port(OT2, "ot2", robot.address, key="url")
    await node.connect()
    try:
        yield node
    finally:
        await node.close()


def keep_handles() -> list[str]:
    """What the node journals as the device's own id."""
    kept: list[str] = []

    async def keep(handle: str) -> None:
        kept.append(handle)

    handle_keeper.set(keep)
    return kept


def status_of(robot: OT2OnWire) -> str:
    return robot.runs[robot.current]["status"] if robot.current else ""


def test_a_protocol_is_run_with_its_values(robot: OT2OnWire, world: World, file: str) -> None:
    (plate,) = world.stock("ot2.deck2", "plate")

    async def body() -> None:
        handles = keep_handles()
        async with drive(robot) as node:
            done = await node.run_protocol(
                file, color_A_volumes=[10.0, 20.0], destination_wells=["A1", "A2"], variables={"reps": 3}
            )
            assert done == {"run": handles[0], "status": "succeeded"}
            assert await node.is_idle()

    run(body)
    (motion,) = world.motions("pipette")
    assert motion.plate == plate
    assert motion.facts == {
        "protocol": hashlib.sha256(PROTOCOL.encode()).hexdigest(),
        "volumes": {"color_A": [10.0, 20.0]},
        "wells": ["A1", "A2"],
        "drawn": {},
    }
    assert not world.is_shut("ot2.deck2")
    assert robot.current == ""  # others may use the robot
    ((_, content),) = robot._files.values()
    told: dict[str, Any] = {}
    exec(content, told)  # what a robot does with it
    assert told["LABOS"]["reps"] == 3


@pytest.mark.parametrize(
    ("name", "text", "more", "why"),
    [
        ("mix.py", "def run(:\n", {}, "refuses the protocol"),
        ("mix.yaml", "commands: []\n", {}, "its equipment are not a list"),
        ("mix.xlsx", "", {}, "not a protocol for an OT-2"),
        ("none.py", None, {}, "no protocol file"),
        ("mix.py", PROTOCOL, {"color_A_volumes": [1.0]}, "1 volumes for 0 destination wells"),
        ("mix.py", PROTOCOL, {"red_volumes": [-1.0], "destination_wells": ["A1"]}, "below 0"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_moves(
    robot: OT2OnWire, tmp_path: Path, name: str, text: str | None, more: dict[str, Any], why: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)

    async def body() -> None:
        handles = keep_handles()
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match=why) as told:
                await node.run_protocol(str(tmp_path / name), **more)
            assert told.value.effects == "none"
            assert handles == []

    run(body)
    assert robot.runs == {}


def test_an_open_door_is_no_start(robot: OT2OnWire, file: str) -> None:
    async def body() -> None:
        async with drive(robot) as node:
            robot.door_is_open = True
            with pytest.raises(DeviceError, match="window is currently open") as told:
                await node.run_protocol(file)
            assert told.value.effects == "none"

    run(body)


def test_somebody_else_has_the_robot(world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        async with drive(robot) as node:
            async with httpx.AsyncClient(base_url=robot.address, headers=HEADERS) as app:
                files = {"files": ("other.py", PROTOCOL.encode())}
                assert (await app.post("/protocols", files=files)).status_code == 201
                uploaded = await app.post("/protocols", files=files)
                assert uploaded.status_code == 200  # it has it already
                body = {"data": {"protocolId": uploaded.json()["data"]["id"]}}
                theirs = (await app.post("/runs", json=body)).json()["data"]["id"]
                await app.post(f"/runs/{theirs}/actions", json={"data": {"actionType": "play"}})
                assert not await node.is_idle()
                with pytest.raises(DeviceError, match="still active") as told:
                    await node.run_protocol(file)
                assert told.value.effects == "none"
                await node.reset()
                ended = (await app.get(f"/runs/{theirs}")).json()["data"]
                assert ended["status"] == "stopped"
            assert await node.is_idle()

    with power_on(OT2OnWire, "ot2", world, pace=300) as robot:
        run(lambda: body(robot))


def test_a_run_that_is_paused_from_outside_goes_on(world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            async with httpx.AsyncClient(base_url=robot.address, headers=HEADERS) as app:
                actions = f"/runs/{robot.current}/actions"
                assert (await app.post(actions, json={"data": {"actionType": "pause"}})).status_code == 201
                again = await app.post(actions, json={"data": {"actionType": "pause"}})
                assert again.status_code == 409
                assert again.json()["errors"][0]["id"] == "RunActionNotAllowed"
                await asyncio.sleep(0.1)
                assert not work.done()
                await app.post(actions, json={"data": {"actionType": "play"}})
                await until(lambda: status_of(robot) == "running")
                robot.after(0, robot.open_door)
                await until(lambda: status_of(robot) == "blocked-by-open-door")
                robot.after(0, robot.shut_door)
                await until(lambda: status_of(robot) == "paused")
                await app.post(actions, json={"data": {"actionType": "play"}})
            assert (await work)["status"] == "succeeded"

    with power_on(OT2OnWire, "ot2", world, pace=300) as robot:
        run(lambda: body(robot))
    assert len(world.motions("pipette")) == 1


def test_a_stop_cancels_the_run(world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            await node.stop()
            with pytest.raises(DeviceError, match="stopped: cancelled") as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(DeviceError, match="was stopped"):
                await node.run_protocol(file)
            await node.reset()
            await node.run_protocol(file)

    with power_on(OT2OnWire, "ot2", world, pace=300) as robot:
        run(lambda: body(robot))


@pytest.mark.parametrize("crash", [False, True])
def test_a_failed_run_says_why(robot: OT2OnWire, world: World, file: str, crash: bool) -> None:
    if not crash:
        world.stock("ot2.deck2", "plate")
        robot.fails_with = "The left pipette has not moved."
    why = "pipettes into nothing" if crash else "MotionFailedError 2001: The left pipette has not moved"

    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match=why) as told:
                await node.run_protocol(file)
            assert told.value.effects == "unknown"
            assert await node.is_idle()

    run(body)


def test_a_run_outlives_its_node(world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        handles = keep_handles()
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            work.cancel()
        async with drive(robot) as node:
            assert not await node.is_idle()
            assert (await node.take_up("run_protocol", handles[0]))["status"] == "succeeded"
            with pytest.raises(DeviceError, match="no run was started") as never:
                await node.take_up("run_protocol", "")
            assert never.value.effects == "none"
            with pytest.raises(OutcomeUnknown):
                await node.take_up("reset", "")

    with power_on(OT2OnWire, "ot2", world, pace=300) as robot:
        run(lambda: body(robot))
    assert len(world.motions("pipette")) == 1


def test_a_run_that_was_only_prepared_never_begins(robot: OT2OnWire, file: str) -> None:
    async def body() -> None:
        async with drive(robot) as node:
            name = await node.device.prepare(file, {})  # type: ignore[union-attr]
            with pytest.raises(DeviceError, match="never started") as told:
                await node.take_up("run_protocol", name)
            assert told.value.effects == "none"
            assert robot.current == ""  # it can no longer be played

    run(body)


def test_a_robot_that_lost_its_power_does_not_guess(world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")
    disk, end = Disk(), HttpEnd()

    async def first(robot: OT2OnWire) -> str:
        handles = keep_handles()
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            work.cancel()
        return handles[0]

    async def second(robot: OT2OnWire, name: str) -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match="stopped: the robot has lost its record") as told:
                await node.take_up("run_protocol", name)
            assert told.value.effects == "unknown"
            with pytest.raises(OutcomeUnknown, match="no longer knows the run run-99"):
                await node.take_up("run_protocol", "run-99")
            await node.reset()
            await node.run_protocol(file)

    with power_on(OT2OnWire, "ot2", world, pace=300, disk=disk, end=end) as robot:
        name = run(lambda: first(robot))
    end.plug()
    with power_on(OT2OnWire, "ot2", world, pace=4000, disk=disk, end=end) as robot:
        run(lambda: second(robot, name))


@pytest.mark.parametrize("reached", [True, False])
def test_a_lost_answer_to_play_starts_nothing_twice(
    robot: OT2OnWire, world: World, file: str, reached: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.stock("ot2.deck2", "plate")
    act = robot._act
    lost = []

    def once(run: dict[str, Any], action: str) -> Reply:
        if action == "play" and not lost:
            lost.append(action)
            if reached:
                act(run, action)
            robot.end.spoil = spoil
            return Reply(201, {})
        return act(run, action)

    def spoil(raw: bytes) -> None:
        robot.end.spoil = lambda raw: raw

    monkeypatch.setattr(robot, "_act", once)

    async def body() -> None:
        async with drive(robot) as node:
            if reached:
                assert (await node.run_protocol(file))["status"] == "succeeded"
                return
            with pytest.raises(LinkError) as told:
                await node.run_protocol(file)
            assert told.value.effects == "none"

    run(body)
    assert len(world.motions("pipette")) == int(reached)


def test_the_robot_may_be_out_of_reach_for_a_while(
    world: World, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            robot.end.unplug()
            await asyncio.sleep(0.1)
            robot.end.plug()
            assert (await work)["status"] == "succeeded"
            monkeypatch.setattr(ot2_driver, "LOST_S", 0.2)
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            robot.end.unplug()
            with pytest.raises(LinkError) as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(LinkError) as gone:
                await node.run_protocol(file)
            assert gone.value.effects == "none"
            robot.end.plug()

    with power_on(OT2OnWire, "ot2", world, pace=300) as robot:
        run(lambda: body(robot))


class Other(OnHttp):
    """Something else at this address."""

    says = Reply(200, {"robot_model": "OT-3 Standard"})

    def answer(self, question: Request) -> Reply:
        return self.says


@pytest.mark.parametrize(
    ("says", "error", "why"),
    [
        (Reply(200, {"robot_model": "OT-3 Standard"}), WrongDevice, "model 'OT-3 Standard' answers"),
        (Reply(200, b"<html>a router</html>"), NotConnected, "not JSON"),
        (Reply(503, {"message": "Motor controller not ready"}), NotConnected, "still starting"),
    ],
)
def test_who_is_no_ot2_is_not_driven(world: World, says: Reply, error: type[DeviceError], why: str) -> None:
    async def body(device: Other) -> None:
        with pytest.raises(error, match=why) as told:
            await at_port(OT2, "ot2", device.address, key="url").connect()
        assert told.value.effects == "none"

    with power_on(Other, "ot2", world) as device:
        device.says = says
        run(lambda: body(device))


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda raw: raw[: len(raw) - 5], LinkError),
        (lambda raw: b"\x00\xff noise\r\n\r\n", LinkError),
        (lambda raw: raw.replace(b'"data"', b'"dada"'), Garbled),
    ],
)
def test_spoilt_answers_are_no_answers(robot: OT2OnWire, spoil: Any, error: type[LinkError]) -> None:
    async def body() -> None:
        async with drive(robot) as node:
            robot.end.spoil = spoil
            with pytest.raises(error):
                await node.is_idle()
            robot.end.spoil = lambda raw: raw
            assert await node.is_idle()

    run(body)


def test_the_server_keeps_its_rules(robot: OT2OnWire) -> None:
    with httpx.Client(base_url=robot.address) as client:
        assert client.get("/health").status_code == 422  # the header is missing
        client.headers = HEADERS
        assert client.get("/health").json()["robot_model"] == "OT-2 Standard"
        assert client.post("/robot/lights", json={"on": True}).json() == {"on": True}
        assert client.get("/runs/nowhere").json()["errors"][0]["id"] == "RunNotFound"
        assert client.post("/runs", json={"data": {"protocolId": "none"}}).status_code == 404
        assert client.post("/protocols", files={"files": ("a.txt", b"x")}).status_code == 422
        names = []
        for number in range(MOST_PROTOCOLS + 1):
            files = {"files": (f"p{number}.py", PROTOCOL.encode())}
            names.append(client.post("/protocols", files=files).json()["data"]["id"])
        assert client.get(f"/protocols/{names[0]}").status_code == 404  # five unused ones are kept
        made = client.post("/runs", json={"data": {"protocolId": names[-1]}}).json()["data"]
        assert made["status"] == protocol.IDLE
        assert client.delete(f"/runs/{made['id']}").status_code == 200


def test_simulated_behind_its_wire(world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")

    async def body() -> None:
        node = OT2(setup_of("ot2", world, 4000, wire=True))
        await node.connect()
        assert (await node.run_protocol(file))["status"] == "succeeded"
        await node.close()

    run(body)


def test_an_end_keeps_its_address() -> None:
    end = HttpEnd()
    address = end.address
    end.unplug()
    end.plug()
    assert end.address == address
    end.close()


OFFSETS = [{"labware": "opentrons/corning_96_wellplate_360ul_flat/2", "slot": 1, "x": 0.1, "z": -0.2}]
SENT = {
    "definitionUri": "opentrons/corning_96_wellplate_360ul_flat/2",
    "location": {"slotName": "1"},
    "vector": {"x": 0.1, "y": 0.0, "z": -0.2},
}


def configure(robot: OT2OnWire, **config: Any) -> OT2:
    return at_port(OT2, "ot2", robot.address, key="url", config=config)


def test_offsets_definitions_and_parameters_reach_the_robot(
    robot: OT2OnWire, world: World, file: str, tmp_path: Path
) -> None:
    world.stock("ot2.deck2", "plate")
    folder = tmp_path / "labware"
    folder.mkdir()
    (folder / "our_plate.json").write_text(json.dumps({"parameters": {}, "wells": {}}))

    async def body() -> None:
        keep_handles()
        node = configure(robot, labware_offsets=OFFSETS, labware_definitions=[str(folder)])
        await node.connect()
        await node.run_protocol(file, parameters={"dry_run": True})
        await node.close()

    run(body)
    (made,) = robot.runs.values()
    assert made["labwareOffsets"] == [SENT]
    assert made["runTimeParameters"] == {"dry_run": True}
    (held,) = robot.protocols.values()
    assert [told["name"] for told in held["files"]] == ["mix.py", "our_plate.json"]


def test_a_robot_that_takes_no_offsets_runs_nothing(robot: OT2OnWire, world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")
    robot.takes_offsets = False

    async def body() -> None:
        node = configure(robot, labware_offsets=OFFSETS)
        await node.connect()
        with pytest.raises(DeviceError, match="has not accepted the labware offsets") as told:
            await node.run_protocol(file)
        assert told.value.effects == "none"
        await node.close()

    run(body)
    assert robot.current == ""
    assert world.motions("pipette") == []


@pytest.mark.parametrize(
    ("config", "why"),
    [
        ({"labware_offsets": {}}, None),
        ({"labware_offsets": "none"}, "is not a list"),
        ({"labware_offsets": [{"slot": 1}]}, "is not an offset"),
        ({"labware_offsets": [{**OFFSETS[0], "slot": 14}]}, "not labware in a slot"),
        ({"labware_offsets": [{**OFFSETS[0], "labware": "corning"}]}, "not labware in a slot"),
        ({"labware_offsets": [{**OFFSETS[0], "x": 200}]}, "20 are allowed"),
        ({"labware_offsets": [{**OFFSETS[0], "x": True}]}, "x is not a number"),
        ({"labware_definitions": ["/nowhere/plate.json"]}, "cannot be read"),
    ],
)
def test_slips_in_the_configuration_of_the_deck(
    robot: OT2OnWire, config: dict[str, Any], why: str | None
) -> None:
    async def body() -> None:
        if why is None:
            await configure(robot, **config).close()
            return
        with pytest.raises(BadInput, match=why):
            await configure(robot, **config).connect()

    run(body)


@pytest.mark.parametrize("how", ["paused", "door", pytest.param("error", marks=pytest.mark.slow)])
def test_a_run_that_waits_for_a_person_says_so_and_is_resumed(world: World, file: str, how: str) -> None:
    """Unseen, it would wait for ever."""
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        keep_handles()
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match="no run waits"):
                await node.resume_run()
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            assert await node.trouble() == ""
            if how == "paused":
                robot.after(0, lambda: robot._act(robot.runs[robot.current], "pause"))
            elif how == "door":
                robot.after(0, robot.open_door)
            else:
                robot.needs_person = True
            waiting = {"paused": "is paused", "door": "is open", "error": "a person can correct"}[how]
            await until(lambda: waiting in node.device.waits_for)  # type: ignore[union-attr]
            assert waiting in await node.trouble()
            if how == "door":
                with pytest.raises(DeviceError, match="nothing can be resumed: its door") as told:
                    await node.resume_run()
                assert told.value.effects == "none"
                robot.after(0, robot.shut_door)
                await until(lambda: status_of(robot) == "paused")
            await node.resume_run()
            assert (await work)["status"] == "succeeded"
            assert await node.trouble() == ""

    with power_on(OT2OnWire, "ot2", world, pace=400) as robot:
        run(lambda: body(robot))


def test_an_analysis_that_is_not_ok_is_no_leave_to_run(robot: OT2OnWire, world: World, file: str) -> None:
    world.stock("ot2.deck2", "plate")
    analyse = robot._analyse

    def wants_a_value(key: str) -> None:
        analyse(key)
        robot.forget_plans()
        robot.protocols[key]["analysisSummaries"][-1] |= {
            "status": "completed",
            "result": "parameter-value-required",
            "errors": [],
        }

    robot._analyse = wants_a_value  # type: ignore[method-assign]

    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match="parameter-value-required") as told:
                await node.run_protocol(file)
            assert told.value.effects == "none"

    run(body)
    assert robot.runs == {}
