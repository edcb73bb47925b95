"""The people of a simulated lab: users who submit runs, and a person who regularly looks at the bench and
answers questions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec

from labos.core import reasons
from labos.core.decide import Command
from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.decide.experiments import EndExperiment
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.nodes import TakeOut
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.ids import SHARED, ExperimentId, ModuleName, StationName, local, split_key
from labos.core.interventions import Intervention
from labos.core.model import Plan, PlanStep
from labos.core.modules import ModuleStatus
from labos.core.runs import PENDING
from labos.core.state import LabState
from labos.core.topics import PlannedWork, UnknownAction
from labos.errors import Fenced, LabosError
from labos.runtime.kernel import Kernel
from labos.runtime.stop import stop_modules
from labos.services.truth import bench_name
from labos.testing.faults import FaultRates
from labos.testing.loop import Killed, Process
from labos.testing.person import look
from labos.testing.processes import Conditions, Processes
from labos.testing.stand import Job, Meddle, Stand

LOOK_S = 10.0
"""How often users and persons look (virtual seconds)."""

ANSWER_S = 5.0
"""How long people wait for the answer of a kernel, because a kernel that dies never answers."""

LATE = 0.7
"""The probability that the person leaves planned work for the next visit."""


class People(Processes):
    """The processes of a lab and the people who use it."""

    def __init__(self, stand: Stand, seed: int, rates: FaultRates, conditions: Conditions) -> None:
        super().__init__(stand, seed, rates, conditions)
        self.answered = 0
        self.resets = 0
        self.emptied = 0
        self.refills = False
        """Whether the person refills resources that runs wait for."""
        self.tidies = False
        """Whether the person removes labware of failed runs that blocks other runs."""
        self.asks_access = False
        """Whether the person asks for access before touching the bench, and waits until it is granted."""
        self.late = 0.0
        """The probability that the person has no time on a visit."""
        self.done_jobs: set[str] = set()
        self._seen: int | None = None
        self._unreported: dict[tuple[str, str], str] = {}
        """The person's changes on the bench that were not reported to a kernel yet."""
        self._inside = False
        """Whether the person may still have access."""
        self._cleared: set[StationName] = set()
        """Stations that the person clears and has not reported to a kernel yet."""
        self._people: list[asyncio.Task[None]] = []

    async def _execute(self, kernel: Kernel, command: Command) -> None:
        await self._ask(kernel, kernel.execute(command, "person"))

    async def _ask(self, kernel: Kernel, work: Coroutine[Any, Any, Any]) -> None:
        """Run a request in the process of a kernel. A frozen kernel carries it out later, a dead one never.
        Raises TimeoutError if it does not answer."""
        task = self.loop.start(self._process_of[kernel], work)
        done, _ = await asyncio.wait({task}, timeout=ANSWER_S)
        if not done:
            raise TimeoutError
        task.result()

    async def _insist(self, command: Command, done: Callable[[LabState], bool] | None = None) -> None:
        """Send a command until its effect is in the log."""
        while True:
            try:
                kernel = self.kernel
                if kernel is not None:
                    if done is not None and done(kernel.state):
                        await self._ask(kernel, kernel.flush())
                        return
                    await self._execute(kernel, command)
                    if done is None:
                        return
            except (LabosError, TimeoutError, Killed):
                pass
            await asyncio.sleep(0.5)

    async def _await(self, holds: Callable[[LabState], bool], look_s: float = LOOK_S) -> None:
        while True:
            kernel = self.kernel
            if kernel is not None:
                try:
                    if holds(kernel.state):
                        return
                except LabosError:
                    pass
            await asyncio.sleep(look_s)

    async def _await_written(self) -> None:
        """Wait until the kernel and the disk have the same events. A replaced kernel does not have all of
        them, so its successor has to answer first."""
        while True:
            kernel = self.kernel
            try:
                if kernel is not None:
                    await self._ask(kernel, kernel.flush())
                    known = kernel.durable == kernel.state.position == self.store.head().position
                    if kernel is self.kernel and known:
                        return
            except (LabosError, TimeoutError, Killed):
                pass
            await asyncio.sleep(0.5)

    async def _act_as_user(self, job: Job) -> None:
        await asyncio.sleep(job.after_s)
        experiment = ExperimentId("")
        if job.experiment is not None:
            request = f"{job.name}/experiment"
            start = msgspec.structs.replace(job.experiment, request=request)
            await self._insist(start, lambda state: request in state.experiments.requests)
            experiment = self.fold_log().experiments.requests[request]
        for number, run in enumerate(job.runs):
            request = f"{job.name}/{number}"
            changes: dict[str, Any] = {"request": request}
            if experiment:
                changes["experiment"] = experiment
            command = msgspec.structs.replace(run, **changes)
            await self._insist(command, lambda state, r=request: r in state.runs.requests)  # type: ignore[misc]
            name = self.fold_log().runs.requests[request]
            await self._await(lambda state, n=name: state.runs.get(n) is None)  # type: ignore[misc]
        if experiment:
            await self._insist(EndExperiment(experiment), lambda state: _is_closed(state, experiment))
            await self._await(lambda state: experiment not in state.experiments.open)
        self.done_jobs.add(job.name)

    async def _refill(self, kernel: Kernel) -> None:
        """Refill the resources that runs wait for."""
        if self._seen == kernel.durable:
            return  # nothing has happened since
        self._seen = kernel.durable
        state, now = kernel.state, kernel.clock.now_ns()
        runs = [*state.runs.active.values(), *state.runs.queued.values()]
        whys = [wait.reason for run in runs for _, wait in kernel.scheduler.list_waits(state, run, now)]
        for why in dict.fromkeys(why for why in whys if isinstance(why, reasons.UsedUp)):
            module, resource = why.module, why.resource
            self._reach_in(kernel)
            level = state.resources.levels[f"{module}:{resource}"]
            amount = level.capacity - level.level
            self.world.supply(local(module), resource, amount)
            fresh = Replenish(ModuleName(module), resource, amount, f"lot{self.kernels}")
            await self._execute(kernel, fresh)
        for stack in {why.place: True for why in whys if isinstance(why, reasons.StackEmpty)}:
            await self._reload(kernel, StationName(stack))

    async def _tidy(self, kernel: Kernel) -> None:
        """Remove labware that blocks runs and does not belong to a run any more."""
        state, now = kernel.state, kernel.clock.now_ns()
        runs = [*state.runs.active.values(), *list(state.runs.queued.values())[:1]]
        whys = [wait.reason for run in runs for _, wait in kernel.scheduler.list_waits(state, run, now)]
        places = {StationName(why.place): True for why in whys if isinstance(why, reasons.Occupied)}
        for module in [ModuleName(why.module) for why in whys if isinstance(why, reasons.Held)]:
            places |= dict.fromkeys(state.bench.by_module.get(module, ()), True)
        if not state.runs.active and any(isinstance(why, reasons.NoWayOut) for why in whys):
            known = state.bench.stations
            places = {n: True for n, s in known.items() if s.labware and not s.spec.is_storage}
        self._cleared |= {place for place in places if _is_left_behind(state, place)}
        await self._report_cleared(kernel)

    async def _report_cleared(self, kernel: Kernel) -> None:
        """Remove the labware at the cleared places and report it; repeat the report until a kernel has
        received it."""
        for place in sorted(self._cleared):
            if not await self._may_touch(kernel):
                return
            self._reach_in(kernel)
            if _is_left_behind(kernel.state, place):
                with self._suspend_faults():
                    for plate in self.world.at(bench_name(kernel.state.bench.stations[place].spec)):
                        self.world.carry(plate, "")
                    await self._execute(kernel, UnloadStation(place, "person"))
            self._cleared.discard(place)

    async def _reload(self, kernel: Kernel, stack: StationName) -> None:
        """Fill a stack with its first content."""
        station = kernel.state.bench.stations[stack]
        kind = next(kind for name, kind, _ in self.stand.stock if name == stack)
        count = station.spec.capacity - station.count
        if count > 0 and stack not in kernel.state.bench.uncertain_at:
            self._reach_in(kernel)
            self.world.stock(local(stack), kind, count)
            await self._execute(kernel, LoadStation(stack, kind, count))

    async def _act_as_person(self) -> None:
        """The person: from time to time looks at the bench and answers questions."""
        while True:
            await asyncio.sleep(2 * LOOK_S)
            kernel = self.kernel
            if kernel is None or (self.late and self.rng.random() < self.late):
                continue
            try:
                await self._ask(kernel, kernel.flush())
                questions = list(kernel.state.interventions.open.values())
                modules = [m for m in kernel.state.modules.by_name.values() if m.status == ModuleStatus.ERROR]
                if self.refills:
                    await self._refill(kernel)
                if self.tidies:
                    await self._tidy(kernel)
                for question in questions:
                    if isinstance(question.topic, PlannedWork) and self.rng.random() < LATE:
                        continue  # there is something else to do first
                    if self.is_moving(question.module):
                        continue  # a module that moves must not be touched
                    unknown = isinstance(question.topic, UnknownAction)
                    if unknown and not await self._is_over_for(kernel, question.module):
                        continue  # it may continue when its node is back
                    if not await self._may_touch(kernel):
                        break  # the piece that fell first is asked about first
                    if question.id in kernel.state.interventions.open:
                        await self._answer(kernel, question)
                        self.answered += 1
                await self._come_out()
                for module in modules:
                    await self._reset(kernel, module.spec.name)
                await self._empty(kernel)
            except (LabosError, TimeoutError, Killed):
                continue

    async def _is_over_for(self, kernel: Kernel, name: str) -> bool:
        """Whether the module has a node or is out of service. The person takes a module out of service whose
        node will never come back."""
        module = kernel.state.modules.by_name[ModuleName(name)]
        lost = local(name) in self.dead and local(name) not in self.mended
        if module.status == ModuleStatus.GONE and lost and not module.out_of_service:
            await self._execute(kernel, TakeOut(module.spec.name, "switched off"))
        return module.status != ModuleStatus.GONE or bool(module.out_of_service)

    async def _may_touch(self, kernel: Kernel) -> bool:
        """Ask for access, if this person does so, and wait some time until it is granted. The request remains
        open."""
        cell = self.stand.workcell.name
        if not self.asks_access:
            return True
        self._inside = True
        await self._execute(kernel, RequestAccess(cell, "person"))
        for _ in range(round(LOOK_S)):
            access = kernel.state.lab.access.get(cell)
            if access is not None and access.granted:
                await self._ask(kernel, kernel.flush())
                return True
            await asyncio.sleep(1.0)
        return False

    async def _come_out(self) -> None:
        """End the access when all changes were reported."""
        kernel, cell = self.kernel, self.stand.workcell.name
        if kernel is None:
            return
        access = kernel.state.lab.access.get(cell)
        # A kernel that was frozen may have received the request late.
        if not self._inside and (access is None or access.by != "person"):
            return
        asked = {(question.kind, question.subject) for question in kernel.state.interventions.open.values()}
        self._unreported = {about: choice for about, choice in self._unreported.items() if about in asked}
        if not any(self._unreported.values()):
            await self._insist(EndAccess(cell, "person"), lambda state: cell not in state.lab.access)
            self._inside = False

    def _reach_in(self, kernel: Kernel) -> None:
        """Get access before the bench is touched. A replaced kernel cannot grant it, because its state is out
        of date. Raises Fenced."""
        if kernel.epoch != self.store.head().epoch:
            raise Fenced("This kernel was replaced.")

    async def _answer(self, kernel: Kernel, question: Intervention) -> None:
        """Look at the bench and answer truthfully. Changes by hand are stored until they were reported,
        because the log cannot know unreported changes."""
        self._reach_in(kernel)
        about = (question.kind, question.subject)
        before = self.world.last_motion()
        remembered = self._unreported.pop(about, "")
        choice = remembered or look(self.world, kernel.state, question)
        moved = bool(remembered) or self.world.last_motion() > before
        try:
            with self._suspend_faults(moved):
                await self._execute(kernel, ResolveIntervention(question.id, choice, "person", result={}))
        except (LabosError, TimeoutError, Killed):
            self._unreported[about] = choice if moved else ""
            raise

    @contextmanager
    def _suspend_faults(self, moved: bool = True) -> Iterator[None]:
        """No fault is drawn while a person who has ``moved`` something reports it."""
        calm = self.faults.calm
        self.faults.calm = calm or moved
        try:
            yield
        finally:
            self.faults.calm = calm

    async def _empty(self, kernel: Kernel) -> None:
        """Empty every waste that is nearly full."""
        for name, station in kernel.state.bench.stations.items():
            room = station.spec.capacity - station.count
            if station.spec.kind == "waste" and station.level and room < min(2, station.spec.capacity):
                self._reach_in(kernel)
                self.world.empty(local(name))
                await self._execute(kernel, UnloadStation(name, "person"))
                self.emptied += 1

    async def _stop(self, module: ModuleName, after_s: float) -> None:
        """Stop a module in an emergency, without a kernel."""
        await asyncio.sleep(after_s)
        bus = self.network.endpoint(Process("person"))
        await stop_modules(bus, await self._await_lab_id(), [module], "person")

    async def _meddle(self, meddle: Meddle) -> None:
        """Interfere with a run when one of its steps has started."""
        await self._await(lambda _: meddle.request in self.fold_log().runs.requests)
        name = self.fold_log().runs.requests[meddle.request]

        def has_begun(state: LabState) -> bool:
            run = state.runs.get(name)
            if run is None:
                return True
            # Another run may have this name: a kernel that was fenced may have given it to a shorter run.
            return meddle.step < len(run.steps) and run.steps[meddle.step].status != PENDING

        await self._await(has_begun, look_s=1.0)  # a picture takes five
        for after_s, deed in meddle.deeds(name):
            await asyncio.sleep(after_s)
            if isinstance(deed, str):
                await self._stop(ModuleName(deed), 0.0)
            elif getattr(deed, "run", None) != name or self.fold_log().runs.get(name) is not None:
                await self._insist(deed)

    async def _reset(self, kernel: Kernel, module: ModuleName) -> None:
        """Ask for a reset, unless one is already requested."""
        step = PlanStep("reset", module, "reset", recovers=True)
        plan = Plan(f"do {local(module)}.reset", self.stand.workcell.name, (step,))
        runs = kernel.state.runs
        if all(run.workflow != plan.workflow for run in (*runs.active.values(), *runs.queued.values())):
            await self._execute(kernel, SubmitRun(plan, "person"))
            self.resets += 1


def _is_closed(state: LabState, experiment: ExperimentId) -> bool:
    found = state.experiments.open.get(experiment)
    return found is None or found.status == "closing"


def _is_left_behind(state: LabState, place: StationName) -> bool:
    """Whether the labware at a place does not belong to a run any more."""
    left = [item for item in state.bench.labware.values() if item.station == place]
    return bool(left) and all(split_key(item.owner)[0] in ("user", SHARED) for item in left)
