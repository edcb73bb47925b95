"""A whole lab in one process: real kernel, real planning, real nodes, on a bad day.

The bus loses messages, processes die at any durable write and send, commits end unknown; a
person answers interventions by looking at the simulated bench, as a real one would. What the
devices did is compared with what the log says.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import random
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from labos.core.decide import Command
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.experiments import EndExperiment, StartExperiment
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.ids import SHARED, ExperimentId, ModuleName, RunId, StationName, local
from labos.core.interventions import PLANNED_WORK
from labos.core.model import Plan, PlanStep, Workcell
from labos.core.runs import PENDING, RunState
from labos.core.state import LabState, state_hash
from labos.errors import LabosError
from labos.node.journal import Journal
from labos.node.node import Node, Setup
from labos.node.server import NodeServer
from labos.node.world import World
from labos.planning.safety import Safety
from labos.planning.scheduler import Scheduler
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel, KernelSettings
from labos.runtime.ledger import fold
from labos.runtime.reconcile import Reconciler
from labos.runtime.registry import Registry
from labos.runtime.stop import stop_modules
from labos.runtime.verify import Verifier
from labos.store import write_segment
from labos.testing.bus import Network
from labos.testing.disk import SimulatedJournalFile, SimulatedStore, SimulatedWriter
from labos.testing.faults import FaultRates, Faults
from labos.testing.loop import CountedIds, Killed, Process, Stalled, VirtualClock, VirtualLoop
from labos.testing.person import look
from labos.testing.truth import differences

ALL_DAY_S = 14 * 24 * 3600.0
"""Virtual time after which a lab that has not finished is given up."""

HEARTBEAT_S = 30.0

LOOK_S = 10.0
"""How often users and persons look (virtual seconds)."""


ANSWER_S = 5.0
"""How long people wait for a kernel to answer: one that dies meanwhile never does."""


class _Slippery(World):
    """A bench on which hands lose what they hold, as often as the faults say."""

    def __init__(self, faults: Faults) -> None:
        super().__init__()
        self._faults = faults
        self.mishaps: Counter[str] = Counter()

    def mishap(self, device: str) -> str:
        how = super().mishap(device) or self._faults.mishap()
        self.mishaps[how] += 1
        return how


class _Trusting(Safety):
    """Lets everything start that the rules allow."""

    def traps(self, state: LabState, run: RunState, step: int, *, only_asking: bool = False) -> list[str]:
        return []


def bare_rule() -> Scheduler:
    """The paper's rule alone: a transfer starts when its source is occupied and its target is
    empty."""
    scheduler = Scheduler()
    scheduler.safety = _Trusting()
    return scheduler


LATE = 0.7
"""How often a person who walks by leaves planned work for the next time."""


class Stand(msgspec.Struct, frozen=True):
    """What a lab is built of: a workcell, what stands there at first, its node classes."""

    workcell: Workcell
    stock: tuple[tuple[StationName, str, int], ...]
    nodes: Mapping[str, type[Node]]


class Job(msgspec.Struct, frozen=True):
    """What a user submits after ``after_s``: an experiment of one or more runs in sequence."""

    name: str
    user: str
    runs: tuple[SubmitRun, ...]
    experiment: StartExperiment | None = None
    after_s: float = 0.0


class Meddle(msgspec.Struct, frozen=True):
    """What somebody does about a run (job/number) as soon as one of its steps has begun: commands, or
    modules that are stopped, each so many seconds after the one before."""

    request: str
    step: int
    deeds: Callable[[RunId], Sequence[tuple[float, Command | str]]]


def cancelling(cancels: Mapping[str, int]) -> list[Meddle]:
    """Users who cancel runs, each when the step named has begun."""
    return [Meddle(name, step, lambda run: [(0.0, CancelRun(run))]) for name, step in cancels.items()]


class SimulatedLab:
    """One lab under one seed. Modules in ``dead`` have no node from the start; those in
    ``doomed`` lose theirs after so many seconds, for good unless somebody mends them after so many more
    (``mended``); ``stops`` are emergency stops: a module, and after how many seconds. With ``still_s``
    the lab is left as soon as nothing has happened for so long."""

    def __init__(
        self,
        stand: Stand,
        seed: int,
        rates: FaultRates,
        *,
        dead: Sequence[str] = (),
        doomed: Mapping[str, float] | None = None,
        mended: Mapping[str, float] | None = None,
        stops: Sequence[tuple[str, float]] = (),
        still_s: float = 0.0,
        meddles: Sequence[Meddle] = (),
        plan_with: Callable[[], Scheduler] = Scheduler,
    ) -> None:
        self.stand = stand
        self.plan_with = plan_with
        self.rng = random.Random(seed)
        self.loop = VirtualLoop()
        self.faults = Faults(rates, self.rng)
        self.faults.calm = True
        self.network = Network(self.faults)
        self.store = SimulatedStore()
        self.world = _Slippery(self.faults)
        self.disk: dict[str, bytes] = {}
        self.kernel: Kernel | None = None
        self.kernels = 0
        self.dead = set(dead)
        self.doomed = dict(doomed or {})
        self.mended = dict(mended or {})
        self.stops = stops
        self.still_s = still_s
        self.meddles = meddles
        self.opened: list[Kernel] = []
        self.answered = 0
        self.resets = 0
        self.emptied = 0
        self.refills = False
        """Whether a person fills up what runs wait for."""
        self.tidies = False
        """Whether a person takes away what a failed run has left in others' way."""
        self.late = 0.0
        """How often a person who walks by has no time to look at anything."""
        self.seed = seed
        self._seen = -1
        self._ids: dict[str, CountedIds] = {}
        self._everybody: list[Process] = []
        self._people: list[asyncio.Task[None]] = []
        self.done_jobs: set[str] = set()
        self.before_restart: Callable[[], None] = lambda: None

    # -- running -----------------------------------------------------------------------------

    def run(self, jobs: Sequence[Job], *, limit_s: float = ALL_DAY_S) -> LabState:
        """Run all jobs to their end; returns the folded log. Raises Stalled if they do not end."""
        state = self.run_for(jobs, limit_s)
        if len(self.done_jobs) < len(jobs):
            raise Stalled(f"seed {self.seed}: after {limit_s:.0f} s: {self.report()}")
        return state

    def run_for(self, jobs: Sequence[Job], limit_s: float) -> LabState:
        """Run until all jobs have ended or the time is over; returns the folded log."""
        asyncio.set_event_loop(self.loop)
        try:
            return self.loop.run_until_complete(asyncio.wait_for(self._run(jobs), limit_s))
        except TimeoutError:
            return self.folded()
        finally:
            asyncio.set_event_loop(None)

    def close(self) -> None:
        """Forget the world. What is still suspended is thrown away: its ports are dead, so that
        nothing of it shows."""
        for process in self._everybody:
            process.on_death.clear()
            process.alive = False
        self.loop.run_until_complete(self._throw_away())
        self.loop.close()
        self.world.close()

    async def _throw_away(self) -> None:
        mine = asyncio.current_task()
        left = [task for process in self._everybody for task in process.tasks]
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
        self._people.append(self.loop.create_task(self._person()))
        for name, after_s in self.doomed.items():
            self.loop.call_later(after_s, self._bury, name)
        for name, after_s in self.stops:
            self._people.append(self.loop.create_task(self._stop(ModuleName(name), after_s)))
        for meddle in self.meddles:
            self._people.append(self.loop.create_task(self._meddle(meddle)))
        users = [self.loop.create_task(self._user(job)) for job in jobs]
        if self.still_s:
            await self._until_still(users)
        if not all(user.done() for user in users) and self.still_s:
            for user in users:
                user.cancel()
            return self.folded()
        await asyncio.gather(*users)
        self.faults.calm = True
        await self._until(lambda state: not (state.actions.open or state.runs.active or state.runs.queued))
        assert self.kernel is not None
        await self.kernel.written()
        return self.folded()

    async def _until_still(self, users: Sequence[asyncio.Task[None]]) -> None:
        """Until all users are done, or nothing but restarts has happened for long."""
        position, since = 0, self.loop.time()
        while not all(user.done() for user in users):
            await asyncio.wait(users, timeout=600.0)
            fresh = self.store.records[position:]
            position += len(fresh)
            if any(not record.head.type.startswith(("node.", "kernel.")) for record in fresh):
                since = self.loop.time()
            elif self.loop.time() - since >= self.still_s:
                return

    def folded(self) -> LabState:
        """The state that the log amounts to, folded from nothing."""
        state = LabState()
        fold(state, self.store.read())
        return state

    def _furnish(self) -> None:
        for station in self.stand.workcell.stations:
            self.world.furnish(local(station.name), station.capacity)
        for name, kind, count in self.stand.stock:
            self.world.stock(local(name), kind, count)
        zones = {local(station.name): station.zone for station in self.stand.workcell.stations}
        zones |= {local(module.name): module.zone for module in self.stand.workcell.modules}
        for place, zone in zones.items():
            if zone:
                self.world.share(zone, place)
        for module in self.stand.workcell.modules:
            for resource, capacity in module.levels.items():
                self.world.supply(local(module.name), resource, capacity)

    async def _set_up(self) -> None:
        await self._insist(ApplyWorkcell(self.stand.workcell))
        contents: dict[StationName, list[str]] = {s.name: [] for s in self.stand.workcell.stations}
        for name, kind, count in self.stand.stock:
            contents[name] += [kind] * count
        for name, types in contents.items():
            await self._insist(DeclareStation(name, tuple(types)))
        alive = [m.name for m in self.stand.workcell.modules if local(m.name) not in self.dead]
        await self._until(lambda state: all(state.modules.by_name[name].status == "IDLE" for name in alive))

    # -- processes ---------------------------------------------------------------------------

    def ids(self, name: str) -> CountedIds:
        return self._ids.setdefault(name, CountedIds(name))

    def _start_kernel(self) -> None:
        self.kernels += 1
        process = Process(f"kernel{self.kernels}")
        self._everybody.append(process)
        process.on_death.append(lambda: self._kernel_died(process))
        self.loop.start(process, self._or_die(process, self._kernel_main(process)))

    def _kernel_died(self, process: Process) -> None:
        self.kernel = None
        self.before_restart()
        self._later(self._start_kernel)

    async def _or_die(self, process: Process, main: Coroutine[Any, Any, None]) -> None:
        """A program that ends with an error is started again like one that was killed."""
        try:
            await main
        except LabosError:
            process.kill()

    async def _kernel_main(self, process: Process) -> None:
        bus = self.network.endpoint(process)
        writer = SimulatedWriter(self.store, self.faults, process)
        settings = KernelSettings(name="simulated", lease_s=1e9, snapshot_every=300)
        clock = VirtualClock(self.loop)
        kernel = Kernel(writer, clock, self.ids("kernel"), settings, self.plan_with)
        self.opened.append(kernel)
        await kernel.open()
        dispatcher = Dispatcher(kernel, bus)
        registry = Registry(kernel, bus, dispatcher, silence_s=10 * HEARTBEAT_S)
        await dispatcher.start()
        await registry.start()
        reconciler = Reconciler(kernel, bus)
        reconciler.start()
        Verifier(kernel, bus).start()
        self.kernel = kernel
        await kernel.failed
        process.kill()

    def _bury(self, name: str) -> None:
        self.dead.add(name)
        for process in self._everybody:
            if process.name == f"node:{self.stand.workcell.name}/{name}":
                process.kill()
        if name in self.mended:
            self.loop.call_later(self.mended[name], self._mend, name, context=contextvars.Context())

    def _mend(self, name: str) -> None:
        self.dead.discard(name)
        self._start_node(f"{self.stand.workcell.name}/{name}")

    def _start_node(self, name: str) -> None:
        if local(name) in self.dead:
            return
        process = Process(f"node:{name}")
        self._everybody.append(process)
        process.on_death.append(lambda: self._later(self._start_node, name))
        self.loop.start(process, self._or_die(process, self._node_main(process, name)))

    async def _node_main(self, process: Process, name: str) -> None:
        spec = next(m for m in self.stand.workcell.modules if m.name == name)
        bus = self.network.endpoint(process)
        ids = self.ids(f"node-{local(name)}")
        journal = await Journal.open(SimulatedJournalFile(self.disk, name, self.faults), ids)
        setup = Setup(
            name=local(name),
            workcell=self.stand.workcell.name,
            config=spec.config.get("config", spec.config),
            regrip=local(spec.regrip),
            world=self.world,
            seed=self.seed,
        )
        node = self.stand.nodes[spec.driver](setup)
        lab = await self._lab_id()
        clock = VirtualClock(self.loop)
        server = NodeServer(node, bus, lab, journal, clock, ids, heartbeat_s=HEARTBEAT_S, idle_poll_s=5.0)
        await server.start()

    async def _lab_id(self) -> str:
        while not self.store.head().lab:
            await asyncio.sleep(0.01)
        return self.store.head().lab

    def _later(self, start: Callable[..., None], *args: str) -> None:
        """Somebody starts a process again after a while; the dead one's context is no part of it."""
        low, high = self.faults.rates.restart_s
        self.loop.call_later(self.rng.uniform(low, high), start, *args, context=contextvars.Context())

    # -- people ------------------------------------------------------------------------------

    async def _insist(self, command: Command, done: Callable[[LabState], bool] | None = None) -> None:
        """Send a command until its effect is in the log."""
        while True:
            try:
                kernel = self.kernel
                if kernel is not None:
                    if done is not None and done(kernel.state):
                        await kernel.written()
                        return
                    await _told(kernel, command)
                    if done is None:
                        return
            except (LabosError, TimeoutError, Killed):
                pass
            await asyncio.sleep(0.5)

    async def _until(self, holds: Callable[[LabState], bool]) -> None:
        while True:
            kernel = self.kernel
            if kernel is not None:
                try:
                    if holds(kernel.state):
                        return
                except LabosError:
                    pass
            await asyncio.sleep(LOOK_S)

    async def _user(self, job: Job) -> None:
        await asyncio.sleep(job.after_s)
        experiment = ExperimentId("")
        if job.experiment is not None:
            request = f"{job.name}/experiment"
            start = msgspec.structs.replace(job.experiment, request=request)
            await self._insist(start, lambda state: request in state.campaigns.requests)
            experiment = self.folded().campaigns.requests[request]
        for number, run in enumerate(job.runs):
            request = f"{job.name}/{number}"
            changes: dict[str, Any] = {"request": request}
            if experiment:
                changes["experiment"] = experiment
            command = msgspec.structs.replace(run, **changes)
            await self._insist(command, lambda state, r=request: r in state.runs.requests)  # type: ignore[misc]
            name = self.folded().runs.requests[request]
            await self._until(lambda state, n=name: state.runs.get(n) is None)  # type: ignore[misc]
        if experiment:
            await self._insist(EndExperiment(experiment), lambda state: _closed(state, experiment))
            await self._until(lambda state: experiment not in state.campaigns.experiments)
        self.done_jobs.add(job.name)

    async def _refill(self, kernel: Kernel) -> None:
        """Somebody sees what runs wait for, and fills it up."""
        if self._seen == kernel.durable:
            return  # nothing has happened since
        self._seen = kernel.durable
        state, now = kernel.state, kernel.clock.now_ns()
        runs = [*state.runs.active.values(), *state.runs.queued.values()]
        waits = [wait for run in runs for _, wait in kernel.scheduler.waits(state, run, now)]
        for module, resource in {wait.names: True for wait in waits if wait.code == "used_up"}:
            level = state.resources.levels[f"{module}:{resource}"]
            amount = level.capacity - level.level
            self.world.supply(local(module), resource, amount)
            fresh = Replenish(ModuleName(module), resource, amount, f"lot{self.kernels}")
            await _told(kernel, fresh)
        for stack in {wait.names[0]: True for wait in waits if wait.code == "stack_empty"}:
            await self._reload(kernel, StationName(stack))

    async def _tidy(self, kernel: Kernel) -> None:
        """Somebody takes away what stands in the way of runs and belongs to no run any more."""
        state, now = kernel.state, kernel.clock.now_ns()
        runs = [*state.runs.active.values(), *list(state.runs.queued.values())[:1]]
        waits = [wait for run in runs for _, wait in kernel.scheduler.waits(state, run, now)]
        places = {StationName(wait.names[0]): True for wait in waits if wait.code == "occupied"}
        for module in [ModuleName(wait.names[0]) for wait in waits if wait.code == "held"]:
            places |= dict.fromkeys(state.bench.by_module.get(module, ()), True)
        if not state.runs.active and any(wait.code == "no_way_out" for wait in waits):
            known = state.bench.stations
            places = {n: True for n, s in known.items() if s.labware and not s.spec.is_storage}
        for place in places:
            left = [item for item in state.bench.labware.values() if item.station == place]
            if left and all(item.owner.startswith(("user:", SHARED)) for item in left):
                for plate in self.world.at(local(place)):
                    self.world.carry(plate, "")
                await _told(kernel, UnloadStation(place, "person"))

    async def _reload(self, kernel: Kernel, stack: StationName) -> None:
        """Somebody fills a stack with what it held at first."""
        station = kernel.state.bench.stations[stack]
        kind = next(kind for name, kind, _ in self.stand.stock if name == stack)
        count = station.spec.capacity - station.count
        if count > 0 and stack not in kernel.state.bench.haunted:
            self.world.stock(local(stack), kind, count)
            await _told(kernel, LoadStation(stack, kind, count))

    async def _person(self) -> None:
        """Walks by now and then, looks at the bench and answers."""
        while True:
            await asyncio.sleep(2 * LOOK_S)
            kernel = self.kernel
            if kernel is None or (self.late and self.rng.random() < self.late):
                continue
            try:
                await asyncio.wait_for(kernel.written(), ANSWER_S)
                questions = list(kernel.state.interventions.open.values())
                modules = [m for m in kernel.state.modules.by_name.values() if m.status == "ERROR"]
                if self.refills:
                    await self._refill(kernel)
                if self.tidies:
                    await self._tidy(kernel)
                for question in questions:
                    if question.kind == PLANNED_WORK and self.rng.random() < LATE:
                        continue  # there is something else to do first
                    choice = look(self.world, kernel.state, question)
                    answer = ResolveIntervention(question.id, choice, "person", result={})
                    await _told(kernel, answer)
                    self.answered += 1
                for module in modules:
                    await self._reset(kernel, module.spec.name)
                await self._empty(kernel)
            except (LabosError, TimeoutError, Killed):
                continue

    async def _empty(self, kernel: Kernel) -> None:
        """Empty every waste that is nearly full."""
        for name, station in kernel.state.bench.stations.items():
            room = station.spec.capacity - station.count
            if station.spec.kind == "waste" and station.level and room < min(2, station.spec.capacity):
                self.world.empty(local(name))
                await _told(kernel, UnloadStation(name, "person"))
                self.emptied += 1

    async def _stop(self, module: ModuleName, after_s: float) -> None:
        """Somebody sees something and stops a module; no kernel is asked."""
        await asyncio.sleep(after_s)
        bus = self.network.endpoint(Process("person"))
        await stop_modules(bus, await self._lab_id(), [module], "person")

    async def _meddle(self, meddle: Meddle) -> None:
        """Somebody does something about a run when one of its steps has begun."""
        await self._until(lambda state: meddle.request in state.runs.requests)
        name = self.folded().runs.requests[meddle.request]

        def begun(state: LabState) -> bool:
            run = state.runs.get(name)
            return run is None or (bool(run.steps) and run.steps[meddle.step] != PENDING)

        await self._until(begun)
        for after_s, deed in meddle.deeds(name):
            await asyncio.sleep(after_s)
            if isinstance(deed, str):
                await self._stop(ModuleName(deed), 0.0)
            elif getattr(deed, "run", None) != name or self.folded().runs.get(name) is not None:
                await self._insist(deed)

    async def _reset(self, kernel: Kernel, module: ModuleName) -> None:
        """Ask for a reset, unless one that was asked for is still to come."""
        step = PlanStep("reset", module, "reset", recovers=True)
        plan = Plan(f"do {local(module)}.reset", self.stand.workcell.name, (step,))
        runs = kernel.state.runs
        if all(run.workflow != plan.workflow for run in (*runs.active.values(), *runs.queued.values())):
            await _told(kernel, SubmitRun(plan, "person"))
            self.resets += 1

    # -- judging -----------------------------------------------------------------------------

    def differences(self, state: LabState) -> list[str]:
        """Where the bench and the log disagree; empty if they agree in every plate."""
        return differences(self.world, state, self.store.records)

    def report(self) -> str:
        """Where a lab that does not end hangs."""
        state = self.folded()
        kernel = self.kernel
        waits = []
        if kernel is not None:
            for run in [*state.runs.active.values(), *list(state.runs.queued.values())[:3]]:
                for step, wait in kernel.scheduler.waits(state, run, kernel.clock.now_ns()):
                    waits.append(f"{run.id}#{step} {wait.code} {wait.names}")
        modules = {local(n): m.status for n, m in state.modules.by_name.items() if m.status != "IDLE"}
        actions = [(a.name, local(a.module), a.status, a.attempt) for a in state.actions.open.values()]
        active = [(run.id, run.steps) for run in state.runs.active.values()]
        return (
            f"active {active}, queued {len(state.runs.queued)}, "
            f"open {actions}, modules {modules}, "
            f"questions {[i.text for i in state.interventions.open.values()]}, waits {waits}, "
            f"jobs done {sorted(self.done_jobs)}"
        )

    def save(self, path: Path) -> None:
        """Keep the log as a file that ``labos replay`` steps through."""
        write_segment(path, self.store.records)

    def fingerprint(self) -> str:
        """The same seed gives the same."""
        return state_hash(self.folded())


def _closed(state: LabState, experiment: ExperimentId) -> bool:
    found = state.campaigns.experiments.get(experiment)
    return found is None or found.status == "closing"


async def _told(kernel: Kernel, command: Command) -> None:
    await asyncio.wait_for(kernel.execute(command, "person"), ANSWER_S)
