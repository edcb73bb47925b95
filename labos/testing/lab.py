"""A whole lab in one process, with a real kernel, real planning and real nodes, under many faults.

The bus loses messages, processes die at any durable write and send, and commits have unknown outcomes. A
simulated person looks at the bench and answers interventions. At the end, the actions of the devices are
compared with the log.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.ids import ModuleName, StationName, local
from labos.core.modules import ModuleStatus
from labos.core.runs import RunState
from labos.core.state import LabState, hash_state
from labos.planning.safety import Safety
from labos.planning.scheduler import Scheduler
from labos.services.truth import list_differences
from labos.store import write_segment
from labos.testing.faults import FaultRates
from labos.testing.loop import Stalled
from labos.testing.people import LOOK_S, People
from labos.testing.processes import Conditions
from labos.testing.stand import Job, Meddle, Stand, make_cancellers

__all__ = ["LOOK_S", "Job", "Meddle", "SimulatedLab", "Stand", "make_bare_scheduler", "make_cancellers"]

ALL_DAY_S = 14 * 24 * 3600.0
"""The virtual time after which an unfinished lab counts as stalled."""


def _is_occupied(station: StationName, state: LabState) -> bool:
    return state.bench.stations[station].count > 0


class _Trusting(Safety):
    """Planning that starts everything that the rules allow."""

    def list_trapped(
        self,
        state: LabState,
        run: RunState,
        step: int,
        *,
        only_asking: bool = False,
        is_blocked: bool | None = None,
    ) -> list[str]:
        return []


def make_bare_scheduler() -> Scheduler:
    """The paper's rule alone: a transfer starts when its source is occupied and its target is
    empty."""
    scheduler = Scheduler()
    scheduler.safety = _Trusting()
    return scheduler


class SimulatedLab(People):
    """One lab under one seed. Modules in ``dead`` never have a node. Modules in ``doomed`` lose their node
    after the given seconds, and get it back after the seconds in ``mended``, if given there. ``stops`` are
    emergency stops: a module, and the seconds after which it is stopped. With ``still_s``, the simulation
    ends when nothing has happened for this time. ``conditions`` are the fields of
    ``Conditions``."""

    def __init__(
        self,
        stand: Stand,
        seed: int,
        rates: FaultRates,
        *,
        doomed: Mapping[str, float] | None = None,
        stops: Sequence[tuple[str, float]] = (),
        still_s: float = 0.0,
        meddles: Sequence[Meddle] = (),
        **conditions: Any,
    ) -> None:
        super().__init__(stand, seed, rates, Conditions(**conditions))
        self.doomed = dict(doomed or {})
        self.stops = stops
        self.still_s = still_s
        self.meddles = meddles
        self.remembered = ""
        """The hash of the kernel's state in memory at the end of the simulation."""
        self.answers_all = False
        """Whether the simulation ends only when no question is open."""

    # -- running -----------------------------------------------------------------------------

    def run(self, jobs: Sequence[Job], *, limit_s: float = ALL_DAY_S) -> LabState:
        """Run all jobs to their end; returns the folded log. Raises Stalled if they do not end."""
        state = self.run_for(jobs, limit_s)
        if len(self.done_jobs) < len(jobs):
            raise Stalled(f"seed {self.seed}: after {limit_s:.0f} s: {self.report()}")
        return state

    def run_for(self, jobs: Sequence[Job], limit_s: float) -> LabState:
        """Run until all jobs have ended or the given time has passed; returns the folded log."""
        asyncio.set_event_loop(self.loop)
        try:
            return self.loop.run_until_complete(asyncio.wait_for(self._run(jobs), limit_s))
        except TimeoutError:
            return self.fold_log()
        finally:
            asyncio.set_event_loop(None)

    def close(self) -> None:
        """Discard the world. Suspended code is discarded too; because its ports are closed, it has no
        effect."""
        for process in self.processes:
            process.on_death.clear()
            process.alive = False
        self.loop.run_until_complete(self._throw_away())
        self.loop.close()
        self.world.close()

    async def _throw_away(self) -> None:
        mine = asyncio.current_task()
        left = [task for process in self.processes for task in process.tasks]
        for task in [*left, *(task for task in asyncio.all_tasks() if task is not mine)]:
            with contextlib.suppress(BaseException):
                coroutine = task.get_coro()
                assert coroutine is not None
                coroutine.close()

    async def _run(self, jobs: Sequence[Job]) -> LabState:
        self._furnish()
        for module in self.stand.workcell.modules:
            self._start_node(module.name)
        self._start_kernel()
        await self._set_up()
        self.faults.calm = False
        self._people.append(self.loop.create_task(self._act_as_person()))
        for name, after_s in self.doomed.items():
            self.loop.call_later(after_s, self._bury, name)
        for name, after_s in self.stops:
            self._people.append(self.loop.create_task(self._stop(ModuleName(name), after_s)))
        for meddle in self.meddles:
            self._people.append(self.loop.create_task(self._meddle(meddle)))
        users = [self.loop.create_task(self._act_as_user(job)) for job in jobs]
        if self.still_s:
            await self._await_stillness(users)
        if not all(user.done() for user in users) and self.still_s:
            for user in users:
                user.cancel()
            return self.fold_log()
        await asyncio.gather(*users)
        for person in self._people:
            if person.done():
                person.result()  # an error in the person's own code is not the subject of the simulation
        self.faults.calm = True
        state = self.fold_log()
        while not self._is_over(state):
            await self._await(self._is_over)
            await self._await_written()
            state = self.fold_log()
            if not self._is_over(state):  # a kernel that was replaced has an older state until it learns this
                await asyncio.sleep(1.0)
        await self._await_written()
        assert self.kernel is not None
        self.remembered = hash_state(self.kernel.state)
        return self.fold_log()

    def _is_over(self, state: LabState) -> bool:
        asked = self.answers_all and (state.interventions.open or self._cleared)
        return not (state.actions.open or state.runs.active or state.runs.queued or asked)

    async def _await_stillness(self, users: Sequence[asyncio.Task[None]]) -> None:
        """Wait until all users are done, or nothing but restarts has happened for ``still_s``."""
        position, since = 0, self.loop.time()
        while not all(user.done() for user in users):
            await asyncio.wait(users, timeout=600.0)
            fresh = self.store.records[position:]
            position += len(fresh)
            if any(not record.head.type.startswith(("node.", "kernel.")) for record in fresh):
                since = self.loop.time()
            elif self.loop.time() - since >= self.still_s:
                return

    async def _set_up(self) -> None:
        await self._insist(ApplyWorkcell(self.stand.workcell))
        contents: dict[StationName, list[str]] = {s.name: [] for s in self.stand.workcell.places}
        for name, kind, count in self.stand.stock:
            contents[name] += [kind] * count
        for name, types in contents.items():
            await self._insist(DeclareStation(name, tuple(types)))
        for load in self.stand.loads:
            self.world.stock(local(load.station), load.labware, load.count)
            if "sealed" in load.set:
                self.world.work("person", "seal", local(load.station))
            await self._insist(load, partial(_is_occupied, load.station))
        alive = [m.name for m in self.stand.workcell.modules if local(m.name) not in self.dead]
        await self._await(
            lambda state: all(state.modules.by_name[name].status == ModuleStatus.IDLE for name in alive)
        )

    # -- judging -----------------------------------------------------------------------------

    def differences(self, state: LabState) -> list[str]:
        """The differences between the bench and the log; empty if they agree on every plate."""
        return list_differences(self.world, state, self.store.records)

    def report(self) -> str:
        """The reasons why a lab that does not end still waits."""
        state = self.fold_log()
        kernel = self.kernel
        waits = []
        if kernel is not None:
            for run in [*state.runs.active.values(), *list(state.runs.queued.values())[:3]]:
                for step, wait in kernel.scheduler.list_waits(state, run, kernel.clock.now_ns()):
                    waits.append(f"{run.id}#{step} {wait.code} {wait.names}")
        modules = {
            local(n): m.status for n, m in state.modules.by_name.items() if m.status != ModuleStatus.IDLE
        }
        actions = [(a.name, local(a.module), a.status, a.attempt) for a in state.actions.open.values()]
        active = [(run.id, run.statuses) for run in state.runs.active.values()]
        return (
            f"active {active}, queued {len(state.runs.queued)}, "
            f"open {actions}, modules {modules}, "
            f"questions {[i.text for i in state.interventions.open.values()]}, waits {waits}, "
            f"jobs done {sorted(self.done_jobs)}"
        )

    def save(self, path: Path) -> None:
        """Store the log as a file for ``labos replay``."""
        write_segment(path, self.store.records)

    def fingerprint(self) -> str:
        """A hash of the result; the same seed gives the same hash."""
        return hash_state(self.fold_log())
