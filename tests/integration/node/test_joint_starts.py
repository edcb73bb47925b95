"""Starts of several runs that a device carries out together: over a real bus, with a real journal."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import msgspec
import pytest

from labos.node.protocol import ActionReply, Ask, JointStart
from tests.integration.bus.contract import until
from tests.integration.node.bench import LAB, Bench, Kernel, arm_of, bench
from tests.integration.ports import free_endpoint
from tests.unit.node.memory import MemoryFile

Check = Callable[[Callable[[Bench], Awaitable[None]]], None]
ALL = ("a1", "a2", "a3")


@pytest.fixture
def check(tmp_path: Path) -> Check:
    """Run a scenario on a bench of its own."""

    def run(scenario: Callable[[Bench], Awaitable[None]]) -> None:
        async def main() -> None:
            async with bench(tmp_path, free_endpoint()) as here:
                await asyncio.wait_for(scenario(here), 30)

        asyncio.run(main())

    return run


def joint(kernel: Kernel, action: str, name: str = "wait", attempt: int = 1, **args: object) -> JointStart:
    fields = msgspec.structs.asdict(kernel.request(action, name, attempt, **args))
    return JointStart(**fields, together=ALL)


def send(kernel: Kernel, *actions: str, attempt: int = 1) -> list[asyncio.Task[ActionReply]]:
    loop = asyncio.get_running_loop()
    return [loop.create_task(kernel.send(joint(kernel, action, attempt=attempt))) for action in actions]


def count(here: Bench, verb: str = "wait") -> int:
    return len(here.world.motions(verb))


def test_the_device_begins_once_when_all_have_come(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        early = send(here.kernel, "a1", "a2")
        await here.kernel.state()
        assert count(here) == 0
        replies = await asyncio.gather(*early, *send(here.kernel, "a3"))
        assert [(reply.status, reply.attempt) for reply in replies] == [("accepted", 1)] * 3
        await until(lambda: count(here) == 1)
        assert sorted((await here.kernel.state()).running) == list(ALL)
        assert (await here.kernel.start("a9")).transient, "it is busy"
        arm_of(server).go.set()
        outcomes = [await here.kernel.outcome(action) for action in ALL]
        assert [outcome.succeeded for outcome in outcomes] == [True] * 3
        assert count(here) == 1
        assert (await here.kernel.start("a10")).status == "finished", "it is free again"

    check(scenario)


def test_if_one_does_not_come_none_begins(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        replies = await asyncio.gather(*send(here.kernel, "a1", "a3"))
        assert [(reply.status, reply.transient) for reply in replies] == [("refused", True)] * 2
        assert "The start of a2" in replies[0].why
        assert [(await here.kernel.ask(action)).status for action in ("a1", "a3")] == ["void", "void"]
        late = await asyncio.gather(*send(here.kernel, "a2"))
        assert late[0].status == "refused"
        assert count(here) == 0
        again = await asyncio.gather(*send(here.kernel, *ALL, attempt=2))
        assert [reply.status for reply in again] == ["accepted"] * 3
        await until(lambda: count(here) == 1)

    check(scenario)


def test_if_one_is_asked_about_meanwhile_none_begins(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        waiting = send(here.kernel, "a1", "a2")
        await here.kernel.state()
        assert (await here.kernel.ask("a2", void=True)).status == "void"
        replies = await asyncio.gather(*waiting)
        assert [reply.status for reply in replies] == ["refused", "refused"]
        assert count(here) == 0

    check(scenario)


def test_if_one_is_refused_none_begins(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        kernel = here.kernel
        waiting = send(kernel, "a1", "a3")
        await kernel.state()
        bad = await kernel.send(joint(kernel, "a2", speed=3))
        assert (bad.status, bad.transient) == ("refused", False)
        replies = await asyncio.gather(*waiting)
        assert [(reply.status, reply.transient) for reply in replies] == [("refused", True)] * 2
        assert "a2" in replies[0].why
        assert count(here) == 0

    check(scenario)


def test_if_the_device_is_busy_when_the_last_comes_none_begins(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        waiting = send(here.kernel, "a1", "a2")
        await here.kernel.state()
        assert (await here.kernel.start("a8", "wait")).status == "accepted"
        replies = await asyncio.gather(*waiting, *send(here.kernel, "a3"))
        assert [(reply.status, reply.transient) for reply in replies] == [("refused", True)] * 3
        assert count(here) == 1

    check(scenario)


def test_who_sends_the_same_twice_gets_the_same_answer(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        replies = await asyncio.gather(*send(here.kernel, "a1", "a1", "a2", "a3", "a3"))
        assert {reply.status for reply in replies} <= {"accepted", "running"}
        await until(lambda: count(here) == 1)

    check(scenario)


def test_after_a_kill_all_have_begun_or_none(check: Check) -> None:
    """What a node writes of starts that belong together is one line: it is torn as a whole."""

    async def scenario(here: Bench) -> None:
        server = await here.node()
        await asyncio.gather(*send(here.kernel, *ALL))
        journal = here.folder / "arm.journal"
        lines = journal.read_bytes().splitlines(keepends=True)
        [line] = [line for line in lines if b'"a1"' in line]
        assert all(name.encode() in line for name in ALL)
        await server.close()
        journal.write_bytes(b"".join(lines[:-1]) + lines[-1][:-9])
        await here.node()
        told = [await here.kernel.send(Ask(LAB, 1, action, 1, 99, void=True)) for action in ALL]
        assert [reply.status for reply in told] == ["void"] * 3

    check(scenario)


def test_a_node_that_dies_meanwhile_knows_of_all_that_it_was_at_it(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.node()
        await asyncio.gather(*send(here.kernel, *ALL))
        await until(lambda: count(here) == 1)
        await server.close()
        await here.node()
        told = [await here.kernel.ask(action) for action in ALL]
        assert [reply.status for reply in told] == ["interrupted"] * 3
        assert count(here) == 1

    check(scenario)


def test_where_the_journal_cannot_be_written_none_begins(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        file = MemoryFile()
        await here.node(file=file)
        file.fail = True
        replies = await asyncio.gather(*send(here.kernel, *ALL))
        assert {reply.status for reply in replies} == {"refused"}
        assert count(here) == 0

    check(scenario)


def test_an_emergency_stop_ends_all_of_them(check: Check) -> None:
    async def scenario(here: Bench) -> None:
        await here.node()
        await asyncio.gather(*send(here.kernel, *ALL))
        await until(lambda: count(here) == 1)
        assert (await here.kernel.admin("estop", by="ada")).done
        for action in ALL:
            await here.kernel.outcome(action)
        assert (await here.kernel.state()).status == "ERROR"

    check(scenario)
