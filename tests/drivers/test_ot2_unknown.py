"""The OT-2 driver where an answer leaves open whether a run has begun, or how it ended."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError, Garbled, LinkError
from labos.node import World
from labos_drivers._onhttp import Reply, Request
from labos_drivers.ot2 import driver as ot2_driver
from labos_drivers.ot2.wire import OT2OnWire
from tests.drivers.test_ot2_wire import PROTOCOL, drive, status_of
from tests.drivers.wires import power_on, run, until


@pytest.fixture
def robot(world: World, monkeypatch: pytest.MonkeyPatch) -> Iterator[OT2OnWire]:
    """It lives a few hundred times as fast as a real one."""
    monkeypatch.setattr(ot2_driver, "POLL_S", 0.01)
    world.stock("ot2.deck2", "plate")
    with power_on(OT2OnWire, "ot2", world, pace=300, simulate="") as device:
        yield device


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "mix.py"
    path.write_text(PROTOCOL)
    return str(path)


@pytest.mark.parametrize("begins", [True, False])
def test_a_server_error_is_no_refusal(
    robot: OT2OnWire,
    world: World,
    file: str,
    begins: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    act = robot._act

    def fails(run: dict[str, Any], action: str) -> Reply:
        if begins:
            act(run, action)
        return Reply(500, {"message": "internal error"})

    monkeypatch.setattr(robot, "_act", fails)

    async def body() -> None:
        async with drive(robot) as node:
            if begins:
                assert (await node.run_protocol(file))["status"] == "succeeded"
                return
            with pytest.raises(LinkError, match="internal error") as told:
                await node.run_protocol(file)
            assert told.value.effects == "none"
            assert robot.current == ""  # it can no longer be played

    run(body)
    assert len(world.motions("pipette")) == int(begins)


def test_a_run_that_begins_while_it_is_given_up_is_seen_through(
    robot: OT2OnWire,
    world: World,
    file: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A start that was on its way for long arrives just before."""
    about_run = robot._about_run

    def late(method: str, told: dict[str, Any], more: tuple[str, ...], question: Request) -> Reply:
        if method == "PATCH" and told["status"] == "idle":
            robot._act(told, "play")
        return about_run(method, told, more, question)

    monkeypatch.setattr(robot, "_about_run", late)

    async def body() -> None:
        async with drive(robot) as node:
            name = await node.device.prepare(file, {})  # type: ignore[union-attr]
            assert (await node.take_up("run_protocol", name))["status"] == "succeeded"

    run(body)
    assert len(world.motions("pipette")) == 1


def test_a_robot_that_cannot_be_asked_tells_nothing(
    robot: OT2OnWire,
    file: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ot2_driver, "LOST_S", 0.1)

    async def body() -> None:
        async with drive(robot) as node:
            name = await node.device.prepare(file, {})  # type: ignore[union-attr]
            robot.end.unplug()
            with pytest.raises(LinkError) as told:
                await node.take_up("run_protocol", name)
            assert told.value.effects == "unknown"

    run(body)


def test_a_robot_that_restarts_its_server_is_waited_for(robot: OT2OnWire, file: str) -> None:
    refused: list[bytes] = []

    def note(raw: bytes) -> bytes:
        refused.append(raw)
        return raw

    async def body() -> None:
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(file))
            await until(lambda: status_of(robot) == "running")
            robot.starting = True
            robot.end.spoil = note
            await until(lambda: any(raw.startswith(b"HTTP/1.1 503") for raw in refused))
            robot.starting = False
            assert (await work)["status"] == "succeeded"

    run(body)


@pytest.mark.parametrize("links", [None, {"current": {}}, {"current": "run-1"}, "missing"])
def test_an_answer_that_names_no_run_does_not_say_that_there_is_none(
    robot: OT2OnWire, monkeypatch: pytest.MonkeyPatch, links: Any
) -> None:
    route = robot._route
    body = {"data": []} if links == "missing" else {"data": [], "links": links}

    def odd(question: Request) -> Reply:
        return Reply(200, dict(body)) if question.parts == ("runs",) else route(question)

    async def asks() -> None:
        async with drive(robot) as node:
            assert await node.is_idle()
            monkeypatch.setattr(robot, "_route", odd)
            with pytest.raises(Garbled, match="does not contain the present run"):
                await node.is_idle()

    run(asks)


def test_a_run_whose_record_is_lost_has_not_succeeded(
    robot: OT2OnWire, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    about_run = robot._about_run

    def loses(method: str, told: dict[str, Any], more: tuple[str, ...], question: Request) -> Reply:
        if (method, more) != ("GET", ()):
            return about_run(method, told, more, question)
        now = dict(told)  # the run may end while it is looked at
        return Reply(200, {"data": {**now, "ok": False} if now["status"] == "succeeded" else now})

    monkeypatch.setattr(robot, "_about_run", loses)

    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match="has lost its record of it") as told:
                await node.run_protocol(file)
            assert told.value.effects == "unknown"

    run(body)


def test_an_analysis_without_a_result_is_no_leave_to_run(
    robot: OT2OnWire, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    analyse = robot._analyse

    def tells_nothing(key: str) -> None:
        analyse(key)
        robot.forget_plans()
        robot.protocols[key]["analysisSummaries"][-1] |= {"status": "completed"}

    monkeypatch.setattr(robot, "_analyse", tells_nothing)

    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match="its analysis ended as None") as told:
                await node.run_protocol(file)
            assert told.value.effects == "none"

    run(body)
    assert robot.runs == {}
