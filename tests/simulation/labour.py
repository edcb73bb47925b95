"""A corner of a lab in which a seed plans every mishap, and which keeps its own account of them.

Two devices work in turns on one run. Between two pieces of work there may be a mishap: the node of the
next device dies for a while, the device jams, measures nonsense, is stopped by somebody, has no ink; a
person pauses the run, reaches in, or has something to do by plan; the kernel dies. The devices' own
clocks say how long it was until work went on.
"""

from __future__ import annotations

import asyncio
import contextvars
import random
from collections import Counter
from itertools import pairwise
from typing import Annotated, Any

from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.runs import PauseRun, ResumeRun, SubmitRun
from labos.core.decide.stock import Replenish
from labos.core.ids import ModuleName, RunId, local
from labos.errors import LabosError
from labos.node import Consumes, DeviceError, Param, action
from labos.runtime.kernel import Kernel
from labos.runtime.stop import stop_modules
from labos.services.standstill import Cause
from labos.spec import compile_workflow, parse_workflow
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab
from labos.testing.loop import Killed, Process
from labos_drivers._simulation import Instrument, Simulated
from tests.simulation.corners import Corner

HOW = ("well", "jam", "nonsense")
WORK_S = 600
SECOND = 1_000_000_000
MISHAPS: dict[str, Cause] = {
    "gone": Cause("error", "node gone", "{next}", "operational"),
    "jam": Cause("error", "failed step", "{next}", "software", asked=True),
    "nonsense": Cause("error", "failed step", "{last}", "experiment", asked=True),
    "stopped": Cause("person", "emergency stop", "{next}"),
    "dry": Cause("resource", "ink", "{next}"),
    "paused": Cause("person", "paused"),
    "hands": Cause("planned", "hands in the workcell", asked=True),
    "by hand": Cause("planned", "work by hand", "corner/operator", asked=True),
    "no kernel": Cause("error", "no kernel", "", "software"),
}
"""What the time between two pieces of work is to be charged to."""


class Labourer(Instrument):
    """Works for ten minutes; jams and measures nonsense once where its order says so."""

    driver = "labourer"
    models = ("labourer",)
    levels = {"ink": 4}
    device: Simulated

    async def connect(self) -> None:
        self.device = Simulated(self.setup)
        self.told = getattr(self.device.world, "told", None)

    @action(Consumes("ink", 1), duration_s=WORK_S)
    async def work(self, n: int, how: Annotated[str, Param(choices=HOW)] = "well") -> dict[str, int]:
        """Work for a while."""
        first = self._note("begin", n)
        try:
            with self.device.motion():
                await self.device.take_time(1 if how == "jam" and first else WORK_S)
        finally:
            self._note("end", n)
        if how == "jam" and first:
            raise DeviceError("It is jammed.", effects="none")
        return {"value": 0 if how == "nonsense" and first else n + 1}

    def _note(self, what: str, n: int) -> bool:
        """Tell the lab's own account; whether it is the first time for this piece of work."""
        return bool(self.told(what, self.setup.name, n)) if self.told else True


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: a, driver: labourer}
  - {name: b, driver: labourer}
  - {name: c, driver: labourer}
  - {name: operator, model: person, config: {alone: false}}
""",
    Labourer,
)


def module_of(n: int) -> str:
    return "ab"[n % 2]


class Day:
    """What a seed plans: how many pieces of work, and what happens before each."""

    def __init__(self, seed: int, pieces: int = 14, without: tuple[str, ...] = ()) -> None:
        rng = random.Random(f"day/{seed}")
        self.rng = rng
        ink = Counter({"a": 4, "b": 4})
        self.before: dict[int, str] = {}
        self.how: dict[int, str] = {}
        kinds = [kind for kind in MISHAPS if kind not in ("dry", *without)]
        rng.shuffle(kinds)
        for n in range(pieces):
            module = module_of(n)
            if ink[module] < 1:
                self.before[n] = "dry"
                ink[module] = 4
            elif n and rng.random() < 0.8:
                self.before[n] = kinds[n % len(kinds)]
            if self.before.get(n) == "jam":
                self.how[n] = "jam"
            if self.before.get(n) == "nonsense" and self.how.setdefault(n - 1, "nonsense") == "jam":
                del self.before[n]
            ink[module] -= 1
        self.pieces = pieces

    def run(self) -> SubmitRun:
        lines = ["labos: 1", "name: day", "steps:"]
        for n in range(self.pieces):
            if self.before.get(n) == "by hand":
                lines.append(
                    f"  - {{name: look {n}, module: operator, action: do, args: {{instruction: look}}}}"
                )
            given = f"n: {n}, how: {self.how.get(n, 'well')}"
            lines.append(
                f"  - {{name: w{n}, module: {module_of(n)}, action: work, args: {{{given}}}, "
                "expect: result.value > 0, on_error: ask}"
            )
        return compile_run("\n".join(lines))


def beside(pieces: int) -> SubmitRun:
    """Work on the third device, without any mishap."""
    steps = "".join(
        f"  - {{name: w{n}, module: c, action: work, args: {{n: {1000 + n}}}}}\n" for n in range(pieces)
    )
    return compile_run(f"labos: 1\nname: beside\nsteps:\n{steps}")


def compile_run(text: str) -> SubmitRun:
    source = parse_workflow(text, "day.yaml")
    workcell, bench = CORNER.cell.workcell, CORNER.cell.bench
    found = compile_workflow(source, {}, workcell, CORNER.descriptions, simulate=True, bench=bench)
    return SubmitRun(found.plan, "ada")


class Witnessed(SimulatedLab):
    """Lives through a day, and keeps its own account: when devices worked, by their clocks, and when
    persons and mishaps came and went. Times in seconds of virtual time."""

    def __init__(self, seed: int, day: Day) -> None:
        super().__init__(CORNER.stand, seed, QUIET)
        self.day = day
        self.world.told = self.note  # type: ignore[attr-defined]
        self.works: list[tuple[str, int, float, float]] = []
        self.spells: list[tuple[str, float, float]] = []
        self.kernel_died = 0.0
        self._begun: dict[int, float] = {}
        self._since: dict[str, float] = {}

    def live(self, *runs: SubmitRun) -> None:
        jobs = [Job(f"j{number}", "ada", (run,)) for number, run in enumerate(runs)]
        self.run(jobs, limit_s=4 * 24 * 3600.0)

    # -- what the devices tell -----------------------------------------------------------------

    def note(self, what: str, module: str, n: int) -> bool:
        now = self.loop.time()
        first = n not in self._begun
        if what == "begin":
            self._begun[n] = now
            whole = n < 1000 and first != (self.day.how.get(n) == "jam")
            mishap = self.day.before.get(n + 1) if whole else None
            if mishap in ("gone", "stopped", "paused", "hands", "no kernel"):
                outside = contextvars.Context()
                self._people.append(self.loop.create_task(self._mishap(mishap, n + 1), context=outside))
        else:
            self.works.append((module, n, self._begun[n], now))
            first = sum(work[1] == n for work in self.works) == 1
        return first

    async def _mishap(self, kind: str, n: int) -> None:
        """Half-way through the piece of work before, something happens; it lasts for long."""
        await asyncio.sleep(WORK_S / 2)
        lasts_s = WORK_S + self.day.rng.uniform(60, 3600)
        began = self.loop.time()
        module = f"corner/{module_of(n)}"
        kernel = self.kernel
        assert kernel is not None
        run = RunId("R1")
        if kind == "gone":
            self.mended[module_of(n)] = lasts_s
            self._bury(module_of(n))
            return
        if kind == "stopped":
            bus = self.network.endpoint(Process("person"))
            await stop_modules(bus, await self._await_lab_id(), [ModuleName(module)], "ada")
            return
        if kind == "no kernel":
            self.kernel_died = lasts_s
            next(p for p in self.processes if p.name == f"kernel{self.kernels}").kill()
            self.spells.append((kind, began, began + lasts_s))
            return
        ask, undo = {
            "paused": (PauseRun(run), ResumeRun(run)),
            "hands": (RequestAccess("corner", "ada"), EndAccess("corner", "ada")),
        }[kind]
        await kernel.execute(ask, "ada")
        await asyncio.sleep(lasts_s)
        assert self.kernel is kernel
        await kernel.execute(undo, "ada")
        self.spells.append((kind, began, self.loop.time()))

    def _schedule_restart(self, start: Any, *args: str) -> None:
        """A kernel is started again when its mishap is over; a node at once, unless it is buried."""
        delay = self.kernel_died if start == self._start_kernel else 1.0
        self.loop.call_later(delay, start, *args, context=contextvars.Context())

    # -- people --------------------------------------------------------------------------------

    async def _act_as_person(self) -> None:
        """Sees to whatever waits for a person, each after a while of its own."""
        while True:
            await asyncio.sleep(5.0)
            kernel = self.kernel
            if kernel is None:
                continue
            try:
                await self._see_to(kernel)
            except (LabosError, Killed):
                continue

    async def _see_to(self, kernel: Kernel) -> None:
        state, now = kernel.state, kernel.clock.now_ns()
        for question in list(state.interventions.open.values()):
            if self._due(question.id):
                choice = {"jam": "retry", "nonsense": "skip"}.get(self._how_of(question.subject), "done")
                answer = ResolveIntervention(question.id, choice, "bo", result={})
                await kernel.execute(answer, "bo")
        for name, module in state.modules.by_name.items():
            if module.status == "ERROR" and self._due(f"{name} in error"):
                await self._reset(kernel, name)
        for run in list(state.runs.active.values()):
            for _, wait in kernel.scheduler.list_waits(state, run, now):
                if wait.code == "used_up" and self._due(f"{wait.names[0]} dry after {len(self.works)}"):
                    self.world.supply(local(ModuleName(wait.names[0])), "ink", 4)
                    await kernel.execute(Replenish(ModuleName(wait.names[0]), "ink", 4, "L"), "bo")

    def _due(self, what: str) -> bool:
        """Whether the person, who has seen it some time ago, comes now."""
        until = self._since.setdefault(what, self.loop.time() + self.day.rng.uniform(120, 3600))
        if self.loop.time() < until:
            return False
        self._since[what] = self.loop.time() + 900.0
        return True

    def _how_of(self, subject: str) -> str:
        """How the piece of work that a question is about was ordered; empty for anything else."""
        run, _, step = subject.partition("#")
        if not step or self.kernel is None:
            return ""
        state = self.kernel.state
        key = state.runs.plan_of(state.runs.active[RunId(run)]).steps[int(step)].key
        return self.day.how.get(int(key[1:]), "")

    # -- the account ---------------------------------------------------------------------------

    def truth(self) -> dict[Cause, float]:
        """Seconds that the first run lost to each cause, by the devices' clocks and the mishaps' own."""
        works = sorted((work for work in self.works if work[1] < 1000), key=lambda work: work[2])
        spells = {
            kind: [(since, until) for name, since, until in self.spells if name == kind] for kind in MISHAPS
        }
        lost: dict[Cause, float] = {}
        for (_, _, begun, ended), (_, n, again, _) in pairwise(works):
            kind = self.day.before.get(n)
            if kind is None:
                continue
            since = ended
            if kind in ("paused", "hands"):  # from when they were asked for
                since = next(s for s, _ in spells[kind] if begun <= s <= ended)
            if kind == "no kernel":  # nothing is heard from the beginning of the work on
                since = begun
            if kind == "jam" and again - ended < 1:
                continue  # the piece of work that jams had only just been begun
            names = {"next": f"corner/{module_of(n)}", "last": f"corner/{module_of(n - 1)}"}
            cause = MISHAPS[kind]
            told = Cause(cause.kind, cause.what, cause.module.format(**names), cause.error_class, cause.asked)
            lost[told] = lost.get(told, 0.0) + again - since
        return lost

    def is_working(self) -> float:
        """Seconds in which at least one device was at work."""
        total, reached = 0.0, 0.0
        for _, _, begun, ended in sorted(self.works, key=lambda work: work[2]):
            total += max(ended - max(begun, reached), 0.0)
            reached = max(reached, ended)
        return total
