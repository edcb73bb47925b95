"""A turn that raises is taken back whole: its caller hears so, memory is as the log is, the lab goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from pathlib import Path

import pytest

from labos.clock import Ids, SystemClock, Uuid7Ids
from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.decide import REACTIONS
from labos.core.decide._base import DECIDERS, Command, Decision
from labos.core.decide.control import PauseStarts
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.nodes import JoinNode
from labos.core.decide.runs import PauseRun, SubmitRun
from labos.core.ids import ActionId, ModuleName, RunId
from labos.core.model import Workcell
from labos.core.registry import Event
from labos.core.runs import RunPaused, RunResumed
from labos.core.state import LabState
from labos.errors import InternalFault, StoreUnavailable
from labos.http.views import run_view
from labos.planning.scheduler import Scheduler, StepStart
from labos.runtime import kernel as kernel_module
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import Entry, load
from labos.runtime.writer import ThreadWriter
from labos.store import open_store
from tests.integration.bus.contract import until
from tests.support.bench import full, module, plan, step, workcell

CELL = workcell([module("dev")], [])
PLAN = plan(step("dev"))
DEV = ModuleName(full("dev"))


class Flawed(Scheduler):
    """Planning with a fault that can be switched on: in what is proposed, or in what is due."""

    proposing = False
    deadlines = False

    def iterate_proposals(self, state: LabState, now: int) -> Iterator[StepStart]:
        if Flawed.proposing:
            raise ZeroDivisionError("a fault in planning")
        return super().iterate_proposals(state, now)

    def find_next_deadline(self, state: LabState) -> int | None:
        if Flawed.deadlines:
            raise RecursionError("a fault in deadlines")
        return super().find_next_deadline(state)


@pytest.fixture(autouse=True)
def _no_fault() -> Iterator[None]:
    yield
    Flawed.proposing = Flawed.deadlines = False


class Contradict(Command, frozen=True):
    """Decides an event that the state cannot take in."""


@pytest.fixture
def contradicting(monkeypatch: pytest.MonkeyPatch) -> None:
    def contradict(state: LabState, command: Contradict) -> Decision:
        return [ActionSucceeded(ActionId("never"), RunId("R9"), 0, DEV, 1)]

    monkeypatch.setitem(DECIDERS, Contradict, contradict)


def in_kernel(
    path: Path,
    work: Callable[[Kernel], Awaitable[None]],
    plan_with: type[Scheduler] = Flawed,
    *,
    furnish: bool = True,
    cell: Workcell = CELL,
    ids: Ids | None = None,
) -> None:
    """Do something in a kernel with one module; then what it remembers must be what the log holds."""
    url = f"sqlite:///{path}/labos.db"

    async def main() -> None:
        store = open_store(url)
        kernel = Kernel(ThreadWriter(store), SystemClock(), ids or Uuid7Ids(), KernelSettings(), plan_with)
        try:
            await kernel.open()
            if furnish:
                await kernel.execute(ApplyWorkcell(cell), "ada")
                join = JoinNode(DEV, "journal", "instance", "driver", "1", "about", "IDLE")
                await kernel.execute(join, "dev")
            await work(kernel)
            await until(lambda: is_open(kernel), 10.0)
            await kernel.flush()
            folded, _ = load(store, snapshots=False)
            assert kernel.state == folded
            assert not kernel.failed.done()
        finally:
            await kernel.close()
            store.close()

    asyncio.run(main())


def is_open(kernel: Kernel) -> bool:
    try:
        return kernel.state.position > 0
    except StoreUnavailable:
        return False


async def await_reopened(kernel: Kernel) -> None:
    await until(lambda: is_open(kernel), 10.0)


def test_a_command_on_which_planning_fails_is_taken_back(tmp_path: Path) -> None:
    async def work(kernel: Kernel) -> None:
        before = kernel.durable
        Flawed.proposing = True
        with pytest.raises(InternalFault, match=r"SubmitRun.*a fault in planning"):
            await kernel.execute(SubmitRun(PLAN, "ada"), "ada")
        Flawed.proposing = False
        await await_reopened(kernel)
        assert kernel.durable == before == kernel.state.position
        await kernel.execute(SubmitRun(PLAN, "eve"), "eve")
        await until(lambda: bool(kernel.state.actions.open), 10.0)

    in_kernel(tmp_path, work)


@pytest.mark.parametrize("part", ["proposing", "deadlines"])
def test_while_planning_keeps_failing_nothing_starts_and_everything_else_works(
    tmp_path: Path, part: str
) -> None:
    async def work(kernel: Kernel) -> None:
        setattr(Flawed, part, True)
        for user in ("ada", "bo", "cy", "di"):
            try:
                await kernel.execute(SubmitRun(PLAN, user), user)
            except InternalFault:
                await await_reopened(kernel)
        await until(lambda: part == "deadlines" or "a fault in planning" in kernel.suspended, 10.0)
        await await_reopened(kernel)
        events = await kernel.execute(SubmitRun(PLAN, "eve"), "eve")
        run = kernel.state.runs.get(events[-1].run)  # type: ignore[attr-defined]
        assert run is not None
        assert bool(kernel.state.actions.open) == (part == "deadlines")
        if part == "proposing":
            (wait,) = run_view(kernel, run, kernel.clock.now_ns(), {}, waits=True).waits
            assert wait.code == "planning_failed"
            assert "a fault in planning" in wait.why
        setattr(Flawed, part, False)
        await until(lambda: is_open(kernel) and bool(kernel.state.actions.open), 20.0)
        assert kernel.suspended == ""

    in_kernel(tmp_path, work)


def test_an_event_that_contradicts_the_state_is_taken_back_and_not_tried_at_every_heartbeat(
    tmp_path: Path, contradicting: None
) -> None:
    async def work(kernel: Kernel) -> None:
        run = (await kernel.execute(SubmitRun(PLAN, "ada"), "ada"))[-1].stream()
        for _ in range(20):  # as a node that repeats it
            kernel.submit(Contradict(), "dev")
            await await_reopened(kernel)
        assert 1 <= len(kernel.faults) <= 5
        await kernel.execute(PauseRun(RunId(run)), "ada")

    in_kernel(tmp_path, work)


def test_a_turn_of_which_there_is_no_end_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def toggle(state: LabState, event: RunPaused | RunResumed) -> Iterator[Event]:
        yield RunResumed(event.run) if isinstance(event, RunPaused) else RunPaused(event.run)

    async def work(kernel: Kernel) -> None:
        run = RunId((await kernel.execute(SubmitRun(PLAN, "ada"), "ada"))[-1].stream())
        before = kernel.durable
        with monkeypatch.context() as endless:
            for kind in (RunPaused, RunResumed):
                endless.setitem(REACTIONS, kind, (toggle,))
            with pytest.raises(InternalFault, match="The reactions to PauseRun do not end"):
                await kernel.execute(PauseRun(run), "ada")
            await await_reopened(kernel)
        assert kernel.durable == before == kernel.state.position
        await kernel.execute(PauseRun(run, "now"), "ada")

    in_kernel(tmp_path, work)


def test_what_was_decided_before_a_turn_that_fails_is_written(tmp_path: Path, contradicting: None) -> None:
    async def work(kernel: Kernel) -> None:
        before = asyncio.create_task(kernel.execute(SubmitRun(PLAN, "ada"), "ada"))
        await asyncio.sleep(0)  # decided, and with the writer
        with pytest.raises(InternalFault):
            await kernel.execute(Contradict(), "dev")
        assert await before

    in_kernel(tmp_path, work)


class Deaf:
    """A listener with a fault."""

    def __init__(self) -> None:
        self.asked_again = 0

    def on_committed(self, entries: Sequence[Entry]) -> None:
        raise KeyError("a fault in a listener")

    def on_reopened(self) -> None:
        self.asked_again += 1


def test_a_listener_that_fails_keeps_nobody_from_hearing(tmp_path: Path) -> None:
    async def work(kernel: Kernel) -> None:
        deaf = Deaf()
        kernel.listeners.insert(0, deaf)
        await kernel.execute(SubmitRun(PLAN, "ada"), "ada")
        assert deaf.asked_again
        assert "a fault in a listener" in kernel.faults[-1]

    in_kernel(tmp_path, work)


def queue_without_planning(path: Path) -> None:
    """A log in which a step could start, and planning has not looked at it."""

    async def work(kernel: Kernel) -> None:
        Flawed.proposing = True
        while not kernel.suspended:
            kernel.submit(PauseStarts("nowhere", "ada"), "ada")
            kernel.wake()
            await await_reopened(kernel)
        await kernel.execute(SubmitRun(PLAN, "ada"), "ada")

    in_kernel(path, work)
    Flawed.proposing = False


def test_a_start_that_breaks_an_invariant_suspends_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it would be proposed, and taken back, for ever, and nobody would find the lab open."""
    queue_without_planning(tmp_path)

    def find_fault(state: LabState, events: Iterable[Event]) -> str:
        return "a fault" if any(isinstance(event, ActionRequested) for event in events) else ""

    async def work(kernel: Kernel) -> None:
        assert "a fault" in kernel.suspended
        turns = kernel.turns
        await kernel.execute(SubmitRun(PLAN, "eve"), "eve")
        assert kernel.turns - turns < 10
        monkeypatch.undo()
        await until(lambda: is_open(kernel) and bool(kernel.state.actions.open), 20.0)

    monkeypatch.setattr(kernel_module, "find_broken_by", find_fault)
    in_kernel(tmp_path, work, furnish=False)


def test_a_kernel_whose_planning_fails_starts(tmp_path: Path) -> None:
    queue_without_planning(tmp_path)

    async def work(kernel: Kernel) -> None:
        await until(lambda: "a fault in planning" in kernel.suspended, 10.0)
        await kernel.execute(PauseRun(RunId("R1")), "ada")

    Flawed.proposing = True
    in_kernel(tmp_path, work, furnish=False)
