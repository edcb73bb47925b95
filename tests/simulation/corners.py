"""Small corners of a lab, each with one rule of the bench to break."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from labos.core.decide.runs import SubmitRun
from labos.core.state import LabState
from labos.node.node import Node
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.spec import compile_workflow, parse_workcell, parse_workflow
from labos.spec.workcell import CompiledWorkcell
from labos.testing.faults import QUIET, FaultRates
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import DESCRIPTIONS, NODES

A_DAY_S = 24 * 3600.0


class Corner:
    """A workcell of simulated instruments, ``more`` among them that only a test knows."""

    def __init__(self, text: str, *more: type[Node]) -> None:
        self.nodes = NODES | {node.driver: node for node in more}
        self.descriptions = DESCRIPTIONS | {node.driver: node.describe() for node in more}
        self.cell: CompiledWorkcell = parse_workcell(text, self.descriptions)
        stock = tuple((s.station, s.labware, s.count) for s in self.cell.bench.stock)
        self.stand = Stand(self.cell.workcell, stock, self.nodes)

    def run(
        self, name: str, *steps: str, user: str = "ada", head: str = "", on_cancel: Sequence[str] = ()
    ) -> SubmitRun:
        """A run of steps, each written ``module.action key=value …``."""
        lines = ["labos: 1", f"name: {name}", *([head] if head else []), "steps:", *_write_steps(steps)]
        lines += ["on_cancel:", *_write_steps(on_cancel)] if on_cancel else []
        return self.read("\n".join(lines), user)

    def read(self, text: str, user: str = "ada") -> SubmitRun:
        """A run of a workflow as a file has it."""
        source = parse_workflow(text, "corner.yaml")
        workcell, bench = self.cell.workcell, self.cell.bench
        compiled = compile_workflow(source, {}, workcell, self.descriptions, simulate=True, bench=bench)
        return SubmitRun(compiled.plan, user)

    def live_through(
        self, runs: Sequence[SubmitRun], seed: int, rates: FaultRates = QUIET, limit_s: float = A_DAY_S
    ) -> LabState:
        """All runs at once, to their ends; the bench and the log agree in every plate."""
        lab = SimulatedLab(self.stand, seed, rates)
        try:
            state = lab.run(jobs(runs), limit_s=limit_s)
            assert lab.differences(state) == [], f"seed {seed}"
            return state
        finally:
            lab.close()

    def crashes(self, runs: Sequence[SubmitRun], seed: int, limit_s: float = 4 * 3600.0) -> list[str]:
        """What crashes on the bench when the same runs go as far as they can."""
        return self.run_anyhow(runs, seed, limit_s)[0]

    def run_anyhow(
        self,
        runs: Sequence[SubmitRun],
        seed: int,
        limit_s: float = 4 * 3600.0,
        plan_with: Callable[[], Scheduler] = make_searching_scheduler,
    ) -> tuple[list[str], list[str]]:
        """What crashes when the same runs go as far as they can, and where the log is wrong about it."""
        lab = SimulatedLab(self.stand, seed, QUIET, plan_with=plan_with)
        try:
            state = lab.run_for(jobs(runs), limit_s)
            crashes = [f"{m.device} {m.facts['what']} at {m.place}" for m in lab.world.crashes()]
            return crashes, lab.differences(state)
        finally:
            lab.close()


def _write_steps(steps: Sequence[str]) -> list[str]:
    lines = []
    for number, step in enumerate(steps):
        what, *args = step.split()
        module, _, action = what.partition(".")
        given = ", ".join(arg.replace("=", ": ", 1) for arg in args)
        lines.append(f"  - {{name: s{number}, module: {module}, action: {action}, args: {{{given}}}}}")
    return lines


def jobs(runs: Sequence[SubmitRun]) -> list[Job]:
    return [Job(f"j{number}", run.user, (run,)) for number, run in enumerate(runs)]
