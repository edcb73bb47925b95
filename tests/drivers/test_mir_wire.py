"""The MiR driver and a simulated MiR behind its REST interface."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import pytest

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown, WrongDevice
from labos.node import World
from labos_drivers._onhttp import OnHttp, Reply, Request
from labos_drivers.mir import MiR, protocol
from labos_drivers.mir import driver as mir_driver
from labos_drivers.mir.wire import MiROnWire
from tests.drivers.test_ot2_wire import keep_handles
from tests.drivers.wires import at_port, power_on, run, setup_of, until

USER, PASSWORD = "labos", "a pass phrase"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot drives a thousand times as fast as a real one."""
    monkeypatch.setattr(mir_driver, "POLL_S", 0.01)
    monkeypatch.setenv("MIR_PASSWORD", PASSWORD)


@pytest.fixture
def base(world: World) -> Iterator[MiROnWire]:
    with power_on(MiROnWire, "mir", world, pace=100, user=USER, password=PASSWORD) as device:
        yield device


@asynccontextmanager
async def drive(base: OnHttp, user: str = USER) -> AsyncIterator[MiR]:
    config = {"user": user, "password_env": "MIR_PASSWORD"}
    node = at_port(MiR, "mir", base.address, key="url", config=config)
    await node.connect()
    try:
        yield node
    finally:
        await node.close()


def test_the_authorization_is_a_digest_in_the_passwords_place() -> None:
    # As the maker's guide builds it: user, colon, SHA-256 of the password in hex.
    assert protocol.make_authorization("u", "p").startswith(
        "Basic dToxNDhkZTljNWE3YTQ0ZDE5ZTU2Y2Q5YWUxYTU1NGJm"
    )


def test_it_drives_and_docks(base: MiROnWire, world: World) -> None:
    async def body() -> None:
        handles = keep_handles()
        async with drive(base) as node:
            assert await node.observe() == {"position": "charger"}
            await node.move("bench2")
            await node.dock("bio_dock")
            await node.move("bench2")
            assert await node.observe() == {"position": "bench2"}
            assert await node.is_idle()
        assert [entry["message"] for entry in base.queue] == handles

    run(body)
    assert [motion.facts["target"] for motion in world.motions("drive")] == ["bench2", "bio_dock", "bench2"]
    assert len(base.missions) == 2  # they are made once
    assert not world.is_shut("mir.deck")


def test_what_cannot_be_done_is_refused_before_anything_moves(base: MiROnWire) -> None:
    async def body() -> None:
        async with drive(base) as node:
            with pytest.raises(DeviceError, match="no position 'moon' on its map") as told:
                await node.move("moon")
            base.state = protocol.MANUAL
            with pytest.raises(DeviceError, match="not ready, but ManualControl") as manual:
                await node.move("bench1")
            with pytest.raises(DeviceError, match="not ready, but ManualControl"):
                await node.reset()
            assert (told.value.effects, manual.value.effects) == ("none", "none")

    run(body)
    assert base.queue == []


@pytest.mark.parametrize(("how", "why"), [("fail", "is in error .no way"), ("press_stop", "emergency stop")])
def test_trouble_on_the_way(base: MiROnWire, world: World, how: str, why: str) -> None:
    async def body() -> None:
        async with drive(base) as node:
            work = asyncio.create_task(node.move("bench2"))
            await until(lambda: base.state == protocol.EXECUTING)
            base.after(0, lambda: base.fail("no way") if how == "fail" else base.press_stop())
            with pytest.raises(DeviceError, match=why) as told:
                await work
            assert told.value.effects == "unknown"
            if how == "press_stop":
                base.state = protocol.PAUSE  # somebody releases it
            # What drives on by itself after a reset would drive without an action.
            await node.reset()
            assert (base.queue[0]["state"], base.state) == ("Aborted", protocol.READY)
            await node.move("bench1")

    run(body)
    assert [motion.facts["target"] for motion in world.motions("drive")] == ["bench1"]


@pytest.mark.parametrize("x", [float("nan"), float("inf"), None, "3"])
def test_a_robot_that_does_not_know_where_it_is_has_not_arrived(base: MiROnWire, x: Any) -> None:
    """Nor is it away from all positions."""
    here = base._compute_position

    async def body() -> None:
        async with drive(base) as node:
            base._compute_position = lambda: (x, 0.0)  # type: ignore[method-assign,return-value,assignment]
            with pytest.raises(Garbled, match="does not contain the robot's position"):
                await node.observe()
            with pytest.raises(Garbled, match="does not contain the robot's position") as told:
                await node.move("bench2")
            assert told.value.effects == "unknown"
            base._compute_position = here  # type: ignore[method-assign]
            assert await node.observe() == {"position": "bench2"}

    run(body)


def test_a_mission_that_was_broken_off_while_it_was_made_gets_its_step(base: MiROnWire, world: World) -> None:
    name = "labos move p-bench1"
    base.missions["mission-1"] = {"guid": "mission-1", "name": name, "actions": []}

    async def body() -> None:
        async with drive(base) as node:
            await node.move("bench1")
            await node.move("bench2")
            await node.move("bench1")

    run(body)
    assert [motion.facts["target"] for motion in world.motions("drive")] == ["bench1", "bench2", "bench1"]
    assert [len(mission["actions"]) for mission in base.missions.values()] == [1, 1]


def test_a_stop_gives_the_journey_up(base: MiROnWire, world: World) -> None:
    async def body() -> None:
        async with drive(base) as node:
            work = asyncio.create_task(node.move("bio_dock"))
            await until(lambda: base.state == protocol.EXECUTING)
            await node.stop()
            with pytest.raises(DeviceError, match="was aborted") as told:
                await work
            assert told.value.effects == "unknown"
            assert base.state == protocol.PAUSE
            await node.reset()
            await node.move("bench1")

    run(body)
    assert [motion.facts["target"] for motion in world.motions("drive")] == ["bench1"]


@pytest.mark.parametrize("queued", [True, False])
def test_a_server_error_does_not_tell_whether_it_was_queued(
    base: MiROnWire, world: World, monkeypatch: pytest.MonkeyPatch, queued: bool
) -> None:
    answer = base.answer

    def fail(question: Request) -> Reply:
        if (question.method, question.parts[2:]) == ("POST", ("mission_queue",)):
            monkeypatch.setattr(base, "answer", answer)
            if queued:
                answer(question)
            return Reply(502, {"error_human": "Bad gateway"})
        return answer(question)

    monkeypatch.setattr(base, "answer", fail)

    async def body() -> None:
        async with drive(base) as node:
            if queued:
                await node.move("bench1")
                return
            with pytest.raises(Garbled, match="status 502") as told:
                await node.move("bench1")
            assert told.value.effects == "unknown"

    run(body)
    assert len(world.motions("drive")) == queued


def test_others_use_the_queue_too(base: MiROnWire, world: World) -> None:
    async def body() -> None:
        async with drive(base) as node:
            await node.move("bench1")
            mission = base.queue[0]["mission_id"]
            headers = {"Authorization": protocol.make_authorization(USER, PASSWORD)}
            async with httpx.AsyncClient(base_url=base.address + protocol.BASE, headers=headers) as fleet:
                work = asyncio.create_task(node.move("bench2"))
                await until(lambda: len(base.queue) == 2)
                theirs = await fleet.post("/mission_queue", json={"mission_id": mission})
                assert theirs.status_code == 201
                await work
                assert (await fleet.get("/mission_queue/99")).status_code == 404
                assert (await fleet.put("/status", json={"state_id": 5})).status_code == 400

    run(body)


def test_a_journey_is_found_again(base: MiROnWire) -> None:
    async def body() -> None:
        handles = keep_handles()
        async with drive(base) as node:
            work = asyncio.create_task(node.move("bio_dock"))
            await until(lambda: base.state == protocol.EXECUTING)
            work.cancel()
        async with drive(base) as node:
            await node.take_up("move", handles[0])
            assert await node.observe() == {"position": "bio_dock"}
            with pytest.raises(OutcomeUnknown, match="has no mission"):
                await node.take_up("move", "labos-never")
            with pytest.raises(DeviceError, match="nothing was started"):
                await node.take_up("move", "")
            with pytest.raises(OutcomeUnknown):
                await node.take_up("reset", "")

    run(body)
    assert len(base.queue) == 1


@pytest.mark.parametrize("reached", [True, False])
def test_a_lost_answer_queues_nothing_twice(
    base: MiROnWire, reached: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = base._add

    def lose(raw: bytes) -> None:
        base.end.spoil = lambda raw: raw

    def once(body: dict[str, Any]) -> Reply:
        base.end.spoil = lose
        monkeypatch.setattr(base, "_add", add)
        return add(body) if reached else Reply(201, {})

    async def body() -> None:
        async with drive(base) as node:
            monkeypatch.setattr(base, "_add", once)
            if reached:
                await node.move("bench1")
                return
            with pytest.raises(LinkError) as told:
                await node.move("bench1")
            assert told.value.effects == "unknown"

    run(body)
    assert len(base.queue) == int(reached)


def test_out_of_reach_for_a_while_and_for_longer(base: MiROnWire, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        async with drive(base) as node:
            work = asyncio.create_task(node.move("bio_dock"))
            await until(lambda: base.state == protocol.EXECUTING)
            base.end.unplug()
            await asyncio.sleep(0.1)  # so long it is between two access points
            base.end.plug()
            await work
            monkeypatch.setattr(mir_driver, "LOST_S", 0.2)
            work = asyncio.create_task(node.move("charger"))
            await until(lambda: base.state == protocol.EXECUTING)
            base.end.unplug()
            with pytest.raises(LinkError) as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(LinkError) as gone:
                await node.move("bench1")
            assert gone.value.effects == "none"

    run(body)


class Other(OnHttp):
    """Something else at this address."""

    def answer(self, question: Request) -> Reply:
        return Reply(200, {"robot_model": "Roomba"})


def test_who_is_no_mir_or_does_not_know_us_is_not_driven(base: MiROnWire, world: World) -> None:
    async def body(other: Other) -> None:
        with pytest.raises(NotConnected, match="does not know this user") as told:
            async with drive(base, user="nobody"):
                pass
        assert told.value.effects == "none"
        with pytest.raises(WrongDevice, match="Roomba"):
            async with drive(other):
                pass

    with power_on(Other, "mir", world) as other:
        run(lambda: body(other))


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda raw: raw[:-3], LinkError),
        (lambda raw: b"\x00\xff noise\r\n\r\n", LinkError),
        (lambda raw: raw.replace(b'"state_id"', b'"state_ix"'), Garbled),
    ],
)
def test_spoilt_answers_are_no_answers(base: MiROnWire, spoil: Any, error: type[LinkError]) -> None:
    async def body() -> None:
        async with drive(base) as node:
            base.end.spoil = spoil
            with pytest.raises(error):
                await node.is_idle()
            base.end.spoil = lambda raw: raw
            assert await node.is_idle()

    run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        told = {"config": {"positions": {"here": [0, 0], "there": [5, 5]}}}
        node = MiR(setup_of("mir", world, 1000, wire=True, **told))
        await node.connect()
        await node.move("there")
        assert await node.observe() == {"position": "there"}
        await node.close()

    run(body)


@pytest.mark.parametrize("state", [0, 1, 2, 9, 42])
def test_a_state_that_is_not_known_is_no_rest(base: MiROnWire, state: int) -> None:
    base.state = state

    async def body() -> None:
        async with drive(base) as node:
            assert not await node.is_idle()
            with pytest.raises(DeviceError, match="it is not ready") as told:
                await node.move("bench1")
            assert told.value.effects == "none"

    run(body)
    assert base.queue == []


def test_a_robot_that_says_nothing_of_errors_is_not_sent_away(base: MiROnWire) -> None:
    status = base._make_status
    base._make_status = lambda: {k: v for k, v in status().items() if k != "errors"}  # type: ignore[method-assign]

    async def body() -> None:
        async with drive(base) as node:
            with pytest.raises(Garbled, match="does not contain the robot's errors") as told:
                await node.move("bench1")
            assert told.value.effects == "none"

    run(body)
    assert base.queue == []


def test_an_answer_without_a_list_does_not_say_that_a_mission_has_no_step(base: MiROnWire) -> None:
    route = base._route

    def tells_nothing(question: Request, *parts: str) -> Reply:
        asks_for_steps = (question.method, parts[-1]) == ("GET", "actions")
        return Reply(200, b"") if asks_for_steps else route(question, *parts)

    async def body() -> None:
        async with drive(base) as node:
            await node.move("bench1")
            base._route = tells_nothing  # type: ignore[method-assign]
            with pytest.raises(Garbled, match="is not a list") as told:
                await node.move("bench1")
            assert told.value.effects == "none"

    run(body)
    assert [len(mission["actions"]) for mission in base.missions.values()] == [1]
