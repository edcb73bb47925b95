"""The node server over a real bus, with a real journal and a bench that counts."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import msgspec
import pytest

from labos.errors import NameTaken
from labos.node.journal import JournalError
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Acknowledge, Ask, ResourcesReport, Start
from tests.integration.bus.contract import until
from tests.integration.node.bench import LAB, MODULE, Arm, Bench, arm_of, bench
from tests.integration.ports import free_endpoint
from tests.unit.node.memory import MemoryFile

Check = Callable[[Callable[[Bench], Awaitable[None]]], None]


@pytest.fixture
def check(tmp_path: Path) -> Check:
    """Run a scenario on a bench of its own."""

    def run(scenario: Callable[[Bench], Awaitable[None]]) -> None:
        async def main() -> None:
            async with bench(tmp_path, free_endpoint()) as here:
                await asyncio.wait_for(scenario(here), 20)

        asyncio.run(main())

    return run


def count_motions(here: Bench, verb: str = "wave") -> int:
    return len(here.world.motions(verb))


# -- carrying out ------------------------------------------------------------------------------


def test_an_action_is_accepted_carried_out_and_its_result_published(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        reply = await kernel.start("a1", "wait")
        assert (reply.status, reply.attempt, reply.journal) == ("accepted", 1, kernel.journal)
        arm_of(server).go.set()
        outcome = await kernel.outcome("a1")
        assert (outcome.succeeded, outcome.effects) == (True, "all")
        assert 0 < outcome.started_ns <= outcome.ended_ns
        again = await kernel.ask("a1")
        assert (again.status, again.outcome) == ("finished", outcome)
        assert (await kernel.state()).finished == ["a1"]
        assert (await kernel.acknowledge(11)).status == "done"
        assert (await kernel.state()).finished == []
        assert (await kernel.ask("a1")).status == "forgotten"
        assert (await kernel.start("a1")).status == "forgotten"
        assert count_motions(here, "wait") == 1

    check(scenario)


def test_an_action_that_is_over_at_once_is_told_in_one_message(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        published: list[str] = []
        await kernel.bus.subscribe(kernel.keys.all_results, lambda key, _: published.append(key))
        reply = await kernel.start("a1", times=2)
        assert (reply.status, reply.attempt, reply.journal) == ("finished", 1, kernel.journal)
        outcome = reply.outcome
        assert outcome is not None
        assert (outcome.succeeded, outcome.effects, outcome.result) == (True, "all", 2)
        assert (await kernel.ask("a1")).outcome == outcome
        # Publications come in order: had the first been published, it would be here by now.
        await kernel.start("a2", "with_handle")
        arm_of(server).go.set()
        await kernel.outcome("a2")
        assert published == [kernel.keys.result(MODULE, "a2")]

    check(scenario)


def test_a_start_that_comes_twice_moves_once(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        replies = await asyncio.gather(*(kernel.start("a1", "wait") for _ in range(20)))
        assert sorted(reply.status for reply in replies) == ["accepted"] + ["running"] * 19
        arm_of(server).go.set()
        await kernel.outcome("a1")
        assert (await kernel.start("a1", "wait")).status == "finished"
        assert count_motions(here, "wait") == 1

    check(scenario)


def test_an_earlier_attempt_that_ran_is_the_truth(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1", "wait")
        second = await kernel.start("a1", "wait", attempt=2)
        assert (second.status, second.attempt) == ("refused", 1)
        assert "Attempt 1 is running" in second.why
        asked = await kernel.ask("a1", 2, void=True)
        assert (asked.status, asked.attempt) == ("running", 1)
        arm_of(server).go.set()
        outcome = await kernel.outcome("a1")
        third = await kernel.start("a1", "wait", attempt=3)
        assert (third.status, third.attempt, third.outcome) == ("finished", 1, outcome)
        # Nor may the later ones run when the first is forgotten.
        await kernel.acknowledge(11)
        assert (await kernel.start("a1", "wait", attempt=2)).status == "void"
        assert (await kernel.start("a1", "wait", attempt=3)).status == "void"
        assert count_motions(here, "wait") == 1

    check(scenario)


def test_a_voided_original_that_comes_late_is_not_carried_out(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        kernel = here.kernel
        assert (await kernel.ask("a1")).status == "unheard"
        assert (await kernel.ask("a1", void=True)).status == "void"
        assert (await kernel.ask("a1")).status == "void"
        assert (await kernel.start("a1")).status == "void"
        assert (await kernel.start("a1", attempt=2)).status == "finished"
        await kernel.outcome("a1")
        # Of an attempt that came before one that ran, nothing may come any more.
        assert (await kernel.ask("a1", 1, void=True)).status == "void"
        assert (await kernel.start("a1", attempt=1)).status == "void"
        assert count_motions(here) == 1

    check(scenario)


@pytest.mark.parametrize("start_first", [True, False])
def test_of_a_start_and_a_voiding_question_that_cross_one_wins(check: Check, start_first: bool) -> None:
    async def scenario(here: Bench) -> None:
        file = MemoryFile()
        server = await here.node(file=file)
        kernel = here.kernel
        file.gate = asyncio.Event()
        start, ask = kernel.request("a1"), Ask(LAB, 1, "a1", 1, 11, void=True)
        first, second = (start, ask) if start_first else (ask, start)
        key = kernel.keys.operation(MODULE, "action")
        before = file.writes
        one = asyncio.create_task(kernel.bus.query(key, msgspec.json.encode(first), 5))
        await until(lambda: file.writes > before)
        other = asyncio.create_task(kernel.bus.query(key, msgspec.json.encode(second), 5))
        await until(lambda: len(server._bus._answering) == 2)  # type: ignore[attr-defined]
        assert count_motions(here) == 0
        file.gate.set()
        statuses = [msgspec.json.decode(await reply)["status"] for reply in (one, other)]
        if start_first:
            assert statuses == ["finished", "finished"]
            assert count_motions(here) == 1
        else:
            assert statuses == ["void", "void"]
            assert (await kernel.state()).running == []
            assert count_motions(here) == 0

    check(scenario)


def test_exclusive_actions_exclude_each_other_and_queries_run_beside(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1", "wait")
        assert (await kernel.state()).status == "BUSY"
        busy = await kernel.start("a2")
        assert busy.status == "refused"
        assert busy.why == "cell/arm is busy: wait (a1)."
        assert (await kernel.start("a3", "look")).status == "finished"
        assert (await kernel.outcome("a3")).result == "nothing"
        assert (await kernel.state()).running == ["a1"]
        arm_of(server).go.set()
        await kernel.outcome("a1")
        await until(lambda: kernel.states[-1].status == "IDLE")
        # What was refused stays refused; another attempt may come.
        assert (await kernel.start("a2")).status == "void"
        assert (await kernel.start("a2", attempt=2)).status == "finished"
        await kernel.outcome("a2")

    check(scenario)


def test_a_blocking_driver_stops_neither_heartbeats_nor_answers(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node(heartbeat_s=0.01)
        kernel = here.kernel
        await kernel.start("a1", "block")
        await until(lambda: count_motions(here, "block") == 1)
        heard = len(kernel.states)
        await until(lambda: len(kernel.states) > heard + 5)
        assert kernel.states[-1].status == "BUSY"
        assert (await kernel.ask("a1")).status == "running"
        arm_of(server).go_thread.set()
        assert (await kernel.outcome("a1")).result == "driver"

    check(scenario)


@pytest.mark.parametrize(
    ("name", "args", "sentence"),
    [
        ("wave", {"times": 9}, "wave: argument 'times' must be a whole number from 1 to 5, not 9."),
        (
            "wave_hand",
            {"times": "2"},
            "wave: argument 'times' must be a whole number from 1 to 5, not '2'.",
        ),
        ("wave", {"speed": 1}, "wave: argument 'speed' is not known: wave takes times."),
        ("fail", {}, "fail: argument 'how' is missing: a text."),
        (
            "dance",
            {},
            "cell/arm has no action 'dance'; "
            "it has wave, home, wait, pick, block, look, with_handle, fail, reset.",
        ),
    ],
)
def test_bad_calls_are_refused_and_nothing_moves(check: Check, name: str, args: dict, sentence: str) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        reply = await here.kernel.start("a1", name, **args)
        assert (reply.status, reply.why) == ("refused", sentence)
        assert (await here.kernel.state()).status == "IDLE"
        assert here.world.motions() == []

    check(scenario)


@pytest.mark.parametrize(
    ("how", "effects", "error", "status"),
    [
        ("device", "partial", "The gripper is jammed. Free it.", "ERROR"),
        ("harmless", "none", "The door is shut.", "IDLE"),
        ("surprise", "unknown", "KeyError: 'oops'", "ERROR"),
        ("crash", "unknown", "Crash: arm grips empty air at nowhere", "ERROR"),
        ("nan", "all", "nan is not a finite number", "IDLE"),
        ("object", "all", "its result cannot be recorded", "IDLE"),
        ("large", "all", "100002 bytes", "IDLE"),
    ],
)
def test_failures_say_what_is_known_of_the_motion(
    check: Check, how: str, effects: str, error: str, status: str
) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1", "fail", how=how)
        outcome = await kernel.outcome("a1")
        assert (outcome.succeeded, outcome.effects) == (False, effects)
        assert error in outcome.error
        assert (await kernel.state()).status == status
        if status == "ERROR":
            refused = await kernel.start("a2")
            assert refused.status == "refused"
            assert outcome.error in refused.why
            assert (await kernel.recover("a9")).succeeded
            assert arm_of(server).resets == 1
        assert (await kernel.start("a3")).status == "finished"
        await kernel.outcome("a3")

    check(scenario)


def test_the_devices_own_handle_is_journalled(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        await here.kernel.start("a1", "with_handle")
        await until(lambda: any(a.handle for a in server.journal.memory.list_attempts()))
        await server.close()
        await here.node()
        about = await here.kernel.about()
        assert [(o.status, o.handle) for o in about.open] == [("interrupted", "run-17")]

    check(scenario)


# -- fencing -----------------------------------------------------------------------------------


def test_an_older_epoch_is_fenced_for_good(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        kernel.epoch = 5
        assert (await kernel.ask("a1")).status == "unheard"
        await server.close()
        await here.node()
        kernel.epoch = 4
        fenced = await kernel.start("a1")
        assert fenced.status == "fenced"
        assert "epoch 5" in fenced.why
        assert (await kernel.ask("a1", void=True)).status == "fenced"
        assert (await kernel.acknowledge(99)).status == "fenced"
        assert (await kernel.reset("a2")).status == "fenced"
        assert not (await kernel.admin("observe")).done
        kernel.epoch = 5
        assert (await kernel.ask("a1")).status == "unheard"
        assert here.world.motions() == []

    check(scenario)


def test_a_node_belongs_to_the_first_lab_that_speaks(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        await here.kernel.ask("a1")
        await server.close()
        await here.node()
        foreign = Start("other", 9, here.kernel.journal, "a1", 1, 11, "wave", {})
        reply = await here.kernel.send(foreign)
        assert (reply.status, reply.why) == ("fenced", "cell/arm belongs to lab lab7, not to other.")
        assert (await here.kernel.send(Acknowledge("other", 9, 100))).status == "fenced"
        assert (await here.kernel.start("a1")).status == "finished"
        await here.kernel.outcome("a1")

    check(scenario)


def test_a_request_for_another_journal_is_refused(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        here.kernel.journal = "lost"
        reply = await here.kernel.start("a1")
        assert reply.status == "refused"
        assert "journal lost" in reply.why
        assert here.world.motions() == []

    check(scenario)


# -- restarts ----------------------------------------------------------------------------------


def test_what_ran_when_the_node_died_is_interrupted_and_never_runs_again(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1")
        await kernel.outcome("a1")
        await kernel.start("a2", "wait")
        await until(lambda: count_motions(here, "wait") == 1)
        await server.close()
        arms: list[Arm] = []

        def move(arm: Arm) -> None:
            arm.idle = False
            arms.append(arm)

        await here.node(prepare=move)
        about = await kernel.about()
        assert [(o.action, o.attempt, o.status) for o in about.open] == [
            ("a1", 1, "finished"),
            ("a2", 1, "interrupted"),
        ]
        state = await kernel.state()
        assert (state.status, state.finished, state.interrupted) == ("BUSY", ["a1"], ["a2"])
        assert "waiting for the device to stop" in (await kernel.start("a3")).why
        arms[0].idle = True
        await until(lambda: kernel.states[-1].status == "IDLE")
        assert (await kernel.ask("a1")).status == "finished"
        assert (await kernel.ask("a2")).status == "interrupted"
        assert (await kernel.start("a2", "wait")).status == "interrupted"
        assert (await kernel.start("a2", "wait", attempt=2)).status == "refused"
        assert count_motions(here, "wait") == 1
        assert (await kernel.acknowledge(22)).status == "done"
        assert (await kernel.about()).open == []

    check(scenario)


def test_what_still_runs_is_not_forgotten_when_acknowledged(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1", "wait")
        await kernel.acknowledge(50)
        assert (await kernel.ask("a1")).status == "running"
        arm_of(server).go.set()
        await kernel.outcome("a1")
        assert (await kernel.ask("a1")).status == "finished"
        await kernel.acknowledge(50)
        assert (await kernel.ask("a1")).status == "forgotten"

    check(scenario)


def test_a_device_that_waits_for_a_reset_to_stand_still(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node(prepare=lambda arm: setattr(arm, "idle", False))
        kernel = here.kernel
        assert (await kernel.start("a1")).status == "refused"
        assert (await kernel.recover("a2")).succeeded
        assert (await kernel.state()).status == "BUSY", "it still does not stand still"
        arm_of(server).idle = True
        await until(lambda: kernel.states[-1].status == "IDLE")
        assert (await kernel.start("a3")).status == "finished"

    check(scenario)


def test_a_device_that_is_not_there_leaves_a_node_that_says_so(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node(prepare=lambda arm: setattr(arm, "present", False))
        kernel = here.kernel
        state = await kernel.state()
        assert state.status == "ERROR"
        assert state.error == "The device is not connected: The arm is switched off. Switch it on."
        assert (await kernel.about()).module == MODULE
        assert (await kernel.start("a1")).status == "refused"
        still = await kernel.recover("a2")
        assert (still.succeeded, still.effects) == (False, "none")
        assert "switched off" in still.error
        assert (await kernel.state()).status == "ERROR"
        arm_of(server).present = True
        assert (await kernel.recover("a3")).succeeded
        assert (await kernel.state()).status == "IDLE"
        assert arm_of(server).resets == 0, "a device that was just connected needs no reset"

    check(scenario)


def test_a_journal_that_cannot_be_written_moves_nothing(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        file = MemoryFile()
        await here.node(file=file)
        kernel = here.kernel
        await kernel.ask("a9")
        file.fail = True
        replies = await asyncio.gather(kernel.start("a1"), kernel.start("a1"), kernel.ask("a2", void=True))
        assert [reply.status for reply in replies] == ["refused"] * 3
        assert "No space left on device" in replies[0].why
        state = await kernel.state()
        assert (state.status, state.running) == ("ERROR", [])
        unmended = await kernel.reset("a3")
        assert unmended.status == "refused"
        assert "No space left on device" in unmended.why
        assert here.world.motions() == []
        file.fail = False
        assert (await kernel.reset("a3")).status == "void", "refused is refused"
        assert (await kernel.recover("a4")).succeeded
        assert (await kernel.start("a1")).status == "void"
        assert (await kernel.start("a1", attempt=2)).status == "finished"
        await kernel.outcome("a1")
        assert count_motions(here) == 1

    check(scenario)


def test_two_nodes_of_one_name(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        first = await here.node()
        with pytest.raises(NameTaken, match="Another node already answers as 'cell/arm'"):
            await here.node(file=MemoryFile())
        assert (await here.kernel.about()).instance == first.instance
        await here.node(name="leg")
        # One that goes away in time makes room.
        waiting = asyncio.create_task(here.node(file=MemoryFile(), grace_s=5.0))
        await asyncio.sleep(0)
        await first.close()
        second = await waiting
        assert (await here.kernel.about()).instance == second.instance

    check(scenario)


def test_one_journal_two_processes(tmp_path: Path) -> None:
    async def main() -> None:
        first = FileJournalFile(tmp_path / "arm.journal")
        with pytest.raises(JournalError, match="in use by another process"):
            FileJournalFile(tmp_path / "arm.journal")
        await first.close()
        await FileJournalFile(tmp_path / "arm.journal").close()

    asyncio.run(main())


# -- recovering --------------------------------------------------------------------------------


def test_a_reset_is_journalled_and_carried_out_once(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1", "fail", how="device")
        await kernel.outcome("a1")
        arm_of(server).go_reset.clear()
        replies = await asyncio.gather(*(kernel.reset("a2") for _ in range(5)), kernel.start("a2", "reset"))
        assert sorted(reply.status for reply in replies) == ["accepted"] + ["running"] * 5
        assert [(a.name, a.status) for a in server.journal.memory.list_attempts()][1:] == [
            ("reset", "running")
        ]
        assert (await kernel.state()).status == "ERROR"
        assert "busy: reset (a2)" in (await kernel.reset("a3")).why
        arm_of(server).go_reset.set()
        outcome = await kernel.outcome("a2")
        assert (outcome.succeeded, outcome.effects) == (True, "all")
        assert (await kernel.reset("a2")).outcome == outcome
        assert (await kernel.state()).status == "IDLE"
        # Nor does one run that was asked about before it came, that is old, or that is another's.
        assert (await kernel.ask("a4", void=True)).status == "void"
        assert (await kernel.reset("a4")).status == "void"
        await kernel.acknowledge(60)
        assert (await kernel.reset("a5")).status == "forgotten"
        kernel.journal = "lost"
        assert (await kernel.reset("a7")).status == "refused"
        assert count_motions(here, "reset") == 1

    check(scenario)


def test_the_operation_reset_takes_recoveries_only(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        refused = await here.kernel.reset("a1", "wave")
        assert (refused.status, refused.transient) == ("refused", False)
        assert refused.why == "wave cannot recover cell/arm from an error."
        assert (await here.kernel.start("a1")).status == "void"
        key = here.kernel.keys.operation(MODULE, "reset")
        asked = await here.kernel.bus.query(key, msgspec.json.encode(Ask(LAB, 1, "a2", 1, 21)), 2.0)
        assert b"cannot be read" in asked
        assert here.world.motions() == []

    check(scenario)


def test_a_stop_during_a_reset_outlasts_it(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        arm_of(server).go_reset.clear()
        await kernel.reset("a1")
        await until(lambda: count_motions(here, "reset") == 1)
        await kernel.admin("estop", by="ada")
        arm_of(server).go_reset.set()
        assert (await kernel.outcome("a1")).succeeded
        state = await kernel.state()
        assert (state.status, state.stopped_by) == ("ERROR", "ada")

    check(scenario)


def test_resets_that_cross_mend_the_journal_once(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        file = MemoryFile()
        server = await here.node(file=file)
        kernel = here.kernel
        await kernel.ask("a9")
        file.fail = True
        assert (await kernel.start("a1")).status == "refused"
        file.fail = False
        replies = await asyncio.gather(*(kernel.reset("a2") for _ in range(8)))
        assert {reply.status for reply in replies} <= {"accepted", "running", "finished"}
        await until(lambda: kernel.states[-1].status == "IDLE")
        assert count_motions(here, "reset") == 1
        await server.close()
        await here.node(file=file)
        assert (await kernel.ask("a2")).status == "finished", "the last mending lost nothing"

    check(scenario)


# -- admin -------------------------------------------------------------------------------------


def test_an_emergency_stop_is_never_fenced(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        kernel.epoch = 3
        await kernel.start("a1", "wait")
        stopped = await kernel.admin("estop", epoch=0, by="ada")
        assert stopped.done
        assert arm_of(server).stops == 1
        await kernel.outcome("a1")
        state = await kernel.state()
        assert (state.status, state.stopped_at, state.stopped_by) == ("ERROR", stopped.result, "ada")
        assert state.error == "Stopped in an emergency by ada; reset the module to go on."
        again = await kernel.admin("estop", epoch=0, by="ada")
        assert (arm_of(server).stops, again.result) == (2, stopped.result), "stopped again, and one stop"
        assert (await kernel.admin("estop", epoch=0, by="bo")).result != stopped.result
        assert (await kernel.start("a2")).status == "refused"
        assert (await kernel.recover("a3")).succeeded
        state = await kernel.state()
        assert (state.status, state.stopped_at) == ("IDLE", 0)

    check(scenario)


def test_a_stop_that_comes_while_an_action_is_journalled_keeps_it_from_moving(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        file = MemoryFile()
        await here.node(file=file)
        kernel = here.kernel
        file.gate = asyncio.Event()
        before = file.writes
        start = asyncio.create_task(kernel.start("a1"))
        await until(lambda: file.writes > before)
        assert (await kernel.admin("stop")).done
        file.gate.set()
        assert (await start).status == "finished"
        outcome = await kernel.outcome("a1")
        assert (outcome.succeeded, outcome.effects) == (False, "none")
        assert here.world.motions() == []

    check(scenario)


def test_what_still_moves_shows_nothing(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        await kernel.start("a1", "wait")
        assert (await kernel.admin("observe")).done, "it moves, and carries nothing"
        arm_of(server).go.set()
        await kernel.outcome("a1")
        arm_of(server).go.clear()
        await kernel.start("a2", "pick")
        seen = await kernel.admin("observe")
        assert (seen.done, seen.result) == (False, None)
        assert "moving labware (pick)" in seen.why
        arm_of(server).go.set()
        assert (await kernel.outcome("a2")).succeeded
        assert (await kernel.admin("observe")).done

    check(scenario)


def test_admin_commands(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        kernel = here.kernel
        assert (await kernel.admin("observe")).result["grip"] == "open"
        assert (await kernel.state()).variables == {"grip": "open"}
        unknown = await kernel.admin("dance")
        assert not unknown.done
        assert "estop, observe, rewind, settled, shutdown, stop, trace" in unknown.why
        assert not (await kernel.admin("reset")).done
        assert not (await kernel.admin("home")).done
        assert (arm_of(server).homes, arm_of(server).resets) == (0, 0)
        assert not server.stopping.is_set()
        assert (await kernel.admin("shutdown")).done
        assert server.stopping.is_set()
        levels = await kernel.bus.query(kernel.keys.operation(MODULE, "resources"), b"", 2.0)
        assert msgspec.json.decode(levels, type=ResourcesReport).levels == {"tape": 12.5}

    check(scenario)


def test_messages_that_cannot_be_read(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        for operation in ("action", "admin", "reset"):
            key = here.kernel.keys.operation(MODULE, operation)
            for payload in (b"", b"{", b"[]", b'{"op":"dance"}', b'{"op":"start","lab":3}'):
                assert b"cannot be read" in await here.kernel.bus.query(key, payload, 2.0)
        assert (await here.kernel.state()).status == "IDLE"

    check(scenario)
