"""Whatever raises in a turn takes back the whole turn. It is told to whoever asked, and to nobody else; it is
counted; what was decided before is written, and the lab goes on.

No rule of LabOS is replaced here: memory is spoilt by hand, a run is made that leaves more behind than one
event can tell, and what the kernel is given from outside (ids, a planner, a meter) fails.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from labos.clock import Uuid7Ids
from labos.core.decide import Command
from labos.core.decide._base import DECIDERS, Decision
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.composites import DeclareStations
from labos.core.decide.control import PauseStarts, ResumeStarts
from labos.core.decide.handover import HandOver
from labos.core.decide.lab import DeclareStation
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation
from labos.core.ids import LabwareId, Owner, RunId, StationName
from labos.core.lab import WHOLE_LAB
from labos.core.labware import LabwarePlaced
from labos.core.state import LabState
from labos.errors import InternalFault
from labos.planning.scheduler import Scheduler, StepStart
from labos.runtime.kernel import Kernel
from tests.integration.runtime.test_turns import PLAN, await_reopened, in_kernel
from tests.support.bench import full, module, station, workcell

A, B, YARD = (StationName(full(name)) for name in ("a", "b", "yard"))
CELL = workcell([module("dev")], [station("a"), station("b"), station("yard", "deck", 5000)])
R1 = RunId("R1")
LEFT = 1000
"""As many pieces as one question is about; with such long names they are more than an event can tell."""


class FailingIds(Uuid7Ids):
    """Gives ``left`` more ids, then none."""

    left = 1_000_000

    def new(self) -> str:
        self.left -= 1
        if self.left < 0:
            raise OSError("no more randomness")
        return super().new()


class Leave(Command, frozen=True):
    """A run has left its labware all over the place."""


@pytest.fixture
def littered(monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(state: LabState, command: Leave) -> Decision:
        first = state.bench.named + 1
        names = (LabwareId(f"P{number:0100}") for number in range(first, first + LEFT))
        return [LabwarePlaced(name, "", "plate", YARD, Owner("run:R1")) for name in names]

    monkeypatch.setitem(DECIDERS, Leave, leave)


def check_taken_back(
    path: Path,
    spoil: Callable[[Kernel], None],
    command: Command,
    fault: str,
    *,
    ids: FailingIds | None = None,
    prepare: tuple[Command, ...] = (),
    plan_with: type[Scheduler] = Scheduler,
) -> None:
    """In a lab where somebody's run waits, ``command`` fails and nothing of it has happened; what was asked
    at the same moment is written; afterwards the same is done as if nothing had been."""

    async def work(kernel: Kernel) -> None:
        declared = tuple(DeclareStation(place) for place in (A, B, YARD))
        await kernel.execute(DeclareStations(declared), "ada")
        await kernel.execute(PauseStarts(WHOLE_LAB, "ada"), "ada")
        await kernel.execute(SubmitRun(PLAN, "ada"), "ada")
        for each in prepare:
            await kernel.execute(each, "ada")
        neighbour = asyncio.create_task(kernel.execute(SubmitRun(PLAN, "bo"), "bo"))
        await asyncio.sleep(0)  # decided, and with the writer
        before, counted = kernel.state.position, kernel.fault_count
        spoil(kernel)
        with pytest.raises(InternalFault, match=fault) as told:
            await kernel.execute(command, "eve")
        assert type(command).__name__ in str(told.value)
        assert kernel.fault_count == counted + 1
        assert (await neighbour)[-1].stream() == "R2"
        await await_reopened(kernel)
        assert kernel.state.position == kernel.durable
        assert kernel.durable >= before
        assert not any(kernel.state.bench.stations[place].labware for place in (A, B)) or prepare
        if ids is not None:
            ids.left = 1_000_000
        assert await kernel.execute(SubmitRun(PLAN, "cy"), "cy")

    in_kernel(path, work, plan_with, cell=CELL, ids=ids)


def no_harm(kernel: Kernel) -> None:
    pass


def test_an_event_that_is_too_large_in_what_follows(tmp_path: Path, littered: None) -> None:
    check_taken_back(tmp_path, no_harm, CancelRun(R1), "exceeds 65536", prepare=(Leave(),))


def test_an_invariant_that_is_broken_in_memory(tmp_path: Path) -> None:
    def spoil(kernel: Kernel) -> None:
        kernel.state.bench.stations[A].labware.append(LabwareId("P9"))

    command = HandOver(LabwareId("P1"), Owner("user:eve"), "eve")
    check_taken_back(tmp_path, spoil, command, "would break", prepare=(LoadStation(A, "plate", 1),))


def test_folding_fails_in_the_midst_of_a_turn(tmp_path: Path) -> None:
    def spoil(kernel: Kernel) -> None:
        kernel.state.bench.stations[B].labware = None  # type: ignore[assignment]

    loads = DeclareStations((DeclareStation(A, ("plate",)), DeclareStation(B, ("plate",))))
    check_taken_back(tmp_path, spoil, loads, "NoneType")


@pytest.mark.parametrize("left", [0, 1, 2])
def test_ids_run_out_before_or_amid_the_events(tmp_path: Path, left: int) -> None:
    ids = FailingIds()

    def spoil(kernel: Kernel) -> None:
        ids.left = left

    loads = DeclareStations((DeclareStation(A, ("plate",)), DeclareStation(B, ("plate",))))
    check_taken_back(tmp_path, spoil, loads, "no more randomness", ids=ids)


class Stumbling(Scheduler):
    """A planner that fails once, after it has proposed something."""

    fails = False

    def iterate_proposals(self, state: LabState, now: int) -> Iterator[StepStart]:
        yield from super().iterate_proposals(state, now)
        if Stumbling.fails:
            Stumbling.fails = False
            raise ArithmeticError("a planner that stumbles")


def test_a_planner_fails_after_its_first_proposal(tmp_path: Path) -> None:
    def spoil(kernel: Kernel) -> None:
        Stumbling.fails = True

    check_taken_back(tmp_path, spoil, ResumeStarts(WHOLE_LAB, "eve"), "stumbles", plan_with=Stumbling)


def test_a_meter_that_fails_takes_nothing_back(tmp_path: Path) -> None:
    def fail(took_s: float) -> None:
        raise ZeroDivisionError("no meter")

    async def work(kernel: Kernel) -> None:
        kernel.on_turn = fail
        assert await kernel.execute(SubmitRun(PLAN, "ada"), "ada")
        kernel.on_turn = lambda took_s: None
        assert kernel.fault_count

    in_kernel(tmp_path, work, cell=CELL)
