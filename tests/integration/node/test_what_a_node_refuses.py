"""What no kernel would say does not stop a node, does not stay in its journal, and is answered."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from labos.bootstrap._node import _learn as learn_setup
from labos.bus import ZenohBus
from labos.errors import DeviceError
from labos.node.files import Attachment, Files, hand_over
from labos.node.limits import MESSAGE_LIMIT, NAME_LIMIT, TEXT_LIMIT
from labos.node.protocol import (
    EPOCH_JUMP,
    GREATEST,
    POSITION_JUMP,
    Acknowledge,
    ActionReply,
    AdminReply,
    AdminRequest,
    Ask,
    ResourcesReport,
    SetupReply,
    Start,
)
from labos.ports import Bus
from tests.integration.bus.contract import until
from tests.integration.node.bench import LAB, MODULE, Bench, arm_of
from tests.integration.node.test_node_server import Check, check

__all__ = ["check"]

_NO_BUS = cast(Bus, None)  # nothing is sent
ABSURD = (GREATEST + 1, 2**62, 2**63, 2**64, 2**70)


def on_disk(here: Bench) -> bytes:
    return (here.folder / "arm.journal").read_bytes()


async def send(here: Bench, operation: str, payload: bytes) -> bytes:
    return await here.kernel.bus.query(here.kernel.keys.operation(MODULE, operation), payload, 5.0)


async def admin(here: Bench, command: str, args: dict[str, Any], epoch: int = 1) -> AdminReply:
    request = msgspec.json.encode(AdminRequest(LAB, epoch, command, args))
    return msgspec.json.decode(await send(here, "admin", request), type=AdminReply)


# -- numbers -----------------------------------------------------------------------------------


@pytest.mark.parametrize("bound", [True, False])
def test_an_epoch_that_no_kernel_has_is_refused_and_not_kept(check: Check, bound: bool) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        if bound:
            await kernel.start("a1")
            await server.journal.sync()
        before = on_disk(here)
        for epoch in (server.journal.memory.epoch + EPOCH_JUMP + 1, *ABSURD):
            for message in (
                Start(LAB, epoch, kernel.journal, "a2", 1, 21, "wave"),
                Ask(LAB, epoch, "a3", 1, 31, void=True),
                Acknowledge(LAB, epoch, 11),
            ):
                reply = await kernel.send(message)
                assert reply.status == "refused", reply
                assert str(epoch) in reply.why
            assert not (await admin(here, "observe", {}, epoch)).done
        assert on_disk(here) == before
        assert (await kernel.start("a2")).status == "finished"
        assert len(here.world.motions("wave")) == 1 + bound

    check(scenario)


def test_the_leap_after_a_restored_backup_is_taken(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        await here.kernel.start("a1")
        here.kernel.epoch = EPOCH_JUMP  # seconds since 2026, in a hundred years
        assert (await here.kernel.start("a2")).status == "finished"

    check(scenario)


def test_a_node_that_belongs_to_nobody_yet_is_not_bound_by_another_lab(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        before = on_disk(here)
        reply = await here.kernel.send(Start("another", 1, server.journal.memory.id, "a1", 1, 11, "wave"))
        assert reply.status == "fenced"
        assert on_disk(here) == before
        assert (await here.kernel.start("a1")).status == "finished"

    check(scenario)


def test_positions_attempts_and_names_that_no_kernel_has_are_refused(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1")
        await server.journal.sync()
        before = on_disk(here)
        odd = [(action, 1, 21) for action in ("", "a/b", "**", "a#", "ä", "a\n", "x" * 201, "a$b?")]
        odd += [("a2", 1, position) for position in (0, -1, -(2**63), *ABSURD)]
        odd += [("a2", attempt, 21) for attempt in (0, -1, 101, 2**31, *ABSURD)]
        for action, attempt, position in odd:
            for message in (
                Start(LAB, 1, kernel.journal, action, attempt, position, "wave"),
                Ask(LAB, 1, action, attempt, position, void=True),
            ):
                assert (await kernel.send(message)).status == "refused", message
        for position in (-1, 11 + POSITION_JUMP + 1, *ABSURD):
            assert (await kernel.acknowledge(position)).status == "refused"
        for position in (-1, -(2**63), *ABSURD, True, "7", 1.5, None, [7]):
            assert not (await kernel.admin("rewind", position=position)).done
        for action, done in (("", True), ("a/b", True), (["a1"], True), ("a1", "yes"), ("x" * 500, False)):
            assert not (await kernel.admin("settled", action=action, done=done)).done
        assert on_disk(here) == before
        assert (await kernel.start("a2")).status == "finished"
        assert (await kernel.acknowledge(11 + POSITION_JUMP)).status == "done"

    check(scenario)


def test_what_may_be_acknowledged_is_known_after_pruning_and_restarts(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a7")  # at position 71
        assert (await kernel.acknowledge(71 + POSITION_JUMP)).status == "done"
        server.journal._compact_at = 0
        for _ in range(2):
            assert (await kernel.acknowledge(72 + POSITION_JUMP)).status == "refused"
            await kernel.ask("a1", void=True)
            await server.close()
            server = await here.node()
            assert server.journal.memory.seen == 71

    check(scenario)


# -- messages ----------------------------------------------------------------------------------


def test_a_message_that_cannot_be_read_is_answered(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        await here.kernel.start("a1")
        await server.journal.sync()
        before = on_disk(here)
        deep = b"[" * 5_000 + b"]" * 5_000
        start = b'{"op":"start","lab":"lab7","epoch":1,"journal":"j","action":"a2","attempt":1,"position":21,'
        observe = b'{"lab":"lab7","epoch":1,"command":"observe",'
        for operation, beginning in (("action", start), ("reset", start), ("admin", observe)):
            name = b"" if operation == "admin" else b'"name":"wave",'
            for payload in (
                b"",
                b"\0\xff",
                deep,
                beginning + name + b'"args":{"x":' + deep + b"}}",
                beginning + name + b'"args":{"x":"\xff\xfe"}}',
                beginning + name + b'"args":{"x":' + b"[" * 60 + b"]" * 60 + b"}}",
                beginning + name + b'"args":{"x":' + b"9" * 6_000 + b"}}",
                beginning + name + b'"args":{"x":"' + b"x" * MESSAGE_LIMIT + b'"}}',
            ):
                answer = await send(here, operation, payload)
                if operation == "admin":
                    reply = msgspec.json.decode(answer, type=AdminReply)
                    assert not reply.done
                    assert 0 < len(reply.why) <= TEXT_LIMIT
                else:
                    told = msgspec.json.decode(answer, type=ActionReply)
                    assert told.status == "refused"
                    assert 0 < len(told.why) <= TEXT_LIMIT
        assert on_disk(here) == before
        assert not (await here.kernel.state()).variables

    check(scenario)


def test_a_stop_is_heard_in_a_message_that_cannot_be_read(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        for args in (b'{"by":"\xff"}', b'{"by":"' + b"x" * MESSAGE_LIMIT + b'"}', b"7"):
            before = arm_of(server).stops
            answer = await send(here, "admin", b'{"command":"estop","args":' + args + b"}")
            assert msgspec.json.decode(answer, type=AdminReply).done
            assert arm_of(server).stops == before + 1
            assert (await here.kernel.state()).status == "ERROR"

    check(scenario)


# -- what a device says ------------------------------------------------------------------------


def test_who_stopped_a_module_is_told_in_one_short_line(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        for by in ("x" * 300_000, "ada\n\x00 lovelace" * 1000, {"by": ["ada"]}):
            await admin(here, "estop", {"by": by}, epoch=0)
            state = await here.kernel.state()
            assert len(state.stopped_by) <= NAME_LIMIT
            assert len(state.error) <= TEXT_LIMIT
            assert "\n" not in state.stopped_by
        assert arm_of(server).stops == 3

    check(scenario)


def test_texts_of_a_device_are_cut(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node(heartbeat_s=0.02)
        kernel, arm = here.kernel, arm_of(server)
        await kernel.start("a1", "fail", how="long words")
        error = (await kernel.outcome("a1")).error
        assert len(error) == TEXT_LIMIT
        assert error.startswith("The gripper is jammed.")
        assert error.endswith("(cut: it has 229999 characters, see the node's log file)")
        await kernel.start("a2", "fail", how="odd words")
        assert (await kernel.outcome("a2")).error == "jammed \ufffd\ufffd\ufffd[31m"
        await kernel.start("a3", "fail", how="mute")
        assert "Mute" in (await kernel.outcome("a3")).error
        await kernel.recover("a4")
        arm.trouble_now = "The door is open. " * 50_000
        await until(lambda: server.state().error != "")
        assert len((await kernel.state()).error) <= TEXT_LIMIT
        assert not server.journal.broken

    check(scenario)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("integer", "an integer of more than 64 bits"),
        ("surrogate", "a text that is not Unicode"),
        ("deep", "nested deeper than 50 levels"),
        ("endless", "nested deeper than 50 levels"),
        ("nan", "not a finite number"),
        ("large", "bytes; 49152 are allowed"),
        ("object", "cannot be recorded"),
    ],
)
def test_an_action_whose_result_cannot_be_told_was_done(check: Check, how: str, said: str) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        await here.kernel.start("a1", "fail", how=how)
        outcome = await here.kernel.outcome("a1")
        assert (outcome.succeeded, outcome.effects, outcome.result) == (False, "all", None)
        assert said in outcome.error
        assert len(outcome.error) <= TEXT_LIMIT
        assert server.status == "IDLE"
        assert (await here.kernel.start("a2")).status == "finished"

    check(scenario)


def test_what_a_device_sees_and_its_levels_are_told_or_refused(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        arm = arm_of(server)
        for odd in ({"n": 2**70}, {"n": float("nan")}, {"n": "\ud800"}, {"n": "x" * 60_000}):
            arm.sees = odd
            reply = await here.kernel.admin("observe")
            assert not reply.done
            assert "cannot be sent" in reply.why or "surrogates" in reply.why
            if odd == {"n": 2**70}:
                continue  # a level is a number with a point
            arm.levels = odd
            answer = await send(here, "resources", b"")
            assert msgspec.json.decode(answer, type=ResourcesReport).error
        assert (await here.kernel.state()).variables == {}

    check(scenario)


def test_a_handle_that_cannot_be_kept_is_not(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        arm_of(server).handle = "x" * (TEXT_LIMIT + 1)
        await here.kernel.start("a1", "with_handle")
        outcome = await here.kernel.outcome("a1")
        assert "own id cannot be stored" in outcome.error
        assert not server.journal.broken

    check(scenario)


def test_an_action_whose_file_is_lost_was_done(tmp_path: Path) -> None:
    async def main() -> None:
        files = Files(bus=_NO_BUS, key="", folder=tmp_path)
        with pytest.raises(DeviceError, match=r"its file scan.tif cannot be read") as caught:
            await hand_over({"scan": Attachment("scan.tif", tmp_path / "scan.tif")}, files)
        assert caught.value.effects == "all"

    asyncio.run(main())


def test_a_starting_node_waits_for_settings_that_can_be_read(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        good = msgspec.json.encode(SetupReply(driver="arm"))
        answers = [b"\xff", b"[" * 5_000, b'{"config":7}', good]

        async def setup(_: bytes) -> bytes:
            return answers.pop(0)

        await here.kernel.bus.serve(here.kernel.keys.setup, setup)
        bus = cast(ZenohBus, await here.bus())
        assert (await learn_setup(bus, LAB, MODULE)).driver == "arm"
        assert answers == []

    check(scenario)
