"""A whole lab in virtual time, for applications that were written for ``LabClient``: kernel, planning, nodes
and simulated instruments are real; while an application computes, no time passes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from msgspec.structs import replace

from labos.client import RunResult, StepResult
from labos.client._replay import as_json
from labos.core.canonical import digest
from labos.core.decide.experiments import EndExperiment, NoteExperiment, StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ExperimentId, RunId
from labos.core.model import Plan
from labos.core.registry import decode
from labos.errors import LabosError
from labos.node.files import Attachment
from labos.ports import Bus
from labos.services.catalogue import Catalogue
from labos.services.runs import RunBook
from labos.spec import compile_workflow, find_spec, load_workcell
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab, Stand
from labos.testing.processes import NotedFiles
from tests.simulation.mixes import DESCRIPTIONS, NODES

LOOK_S = 1.0
"""How often an application looks whether a run has ended (lab seconds)."""


class KeptFiles(NotedFiles):
    """The files of a lab in memory."""

    def __init__(self, bus: Bus, kept: dict[str, bytes]) -> None:
        super().__init__(bus, "", Path())
        self.kept = kept

    async def send(self, attachment: Attachment) -> dict[str, Any]:
        content = attachment.content
        data = content if isinstance(content, bytes) else content.read_bytes()
        self.kept[digest(data)] = data
        return await super().send(attachment)


class VirtualLab(SimulatedLab):
    """A lab with a packaged workcell; as much of a ``LabClient`` as applications need."""

    def __init__(self, workcell: str, seed: int = 0, *, config: Mapping[str, Mapping[str, Any]] = {}) -> None:
        self.cell = load_workcell(find_spec("workcells", workcell), DESCRIPTIONS)
        stock = tuple((s.station, s.labware, s.count) for s in self.cell.bench.stock)
        modules = tuple(
            replace(
                m,
                config={
                    **m.config,
                    "config": {**m.config.get("config", {}), **config[m.name.rpartition("/")[2]]},
                },
            )
            if m.name.rpartition("/")[2] in config
            else m
            for m in self.cell.workcell.modules
        )
        super().__init__(
            Stand(replace(self.cell.workcell, modules=modules), stock, NODES),
            seed,
            QUIET,
            snapshot_every=10**9,
        )
        self.kept: dict[str, bytes] = {}
        self._names, self._read = Catalogue(), 0
        self._book = RunBook(self._names)

    def __enter__(self) -> VirtualLab:
        self._do(self._open())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def files_of(self, bus: Bus) -> KeptFiles:
        return KeptFiles(bus, self.kept)

    def file(self, file: str | Mapping[str, Any]) -> bytes:
        return self.kept[str(file["sha256"] if isinstance(file, Mapping) else file)]

    def status(self, run: str) -> RunResult:
        self._learn()
        told = self._book.runs[run]
        steps = [
            StepResult(s.key, s.module, s.action, s.state, s.result, s.error, s.requested_at, s.ended_at)
            for s in told.steps
        ]
        return RunResult(
            told.id,
            told.workflow,
            told.user,
            told.status,
            told.why,
            told.experiment,
            told.submitted_at,
            told.started_at,
            told.ended_at,
            steps,
        )

    def execute(self, command: Any) -> None:
        assert self.kernel is not None
        self._do(self._ask(self.kernel, self.kernel.execute(command, "app")))

    def wait(self, holds: Callable[[], bool]) -> None:
        self._do(self._await(lambda state: holds(), LOOK_S))

    def plan(self, workflow: Path, payload: Mapping[str, Any]) -> Plan:
        workcell, bench = self.cell.workcell, self.cell.bench
        return compile_workflow(workflow, payload, workcell, DESCRIPTIONS, simulate=True, bench=bench).plan

    def now_ns(self) -> int:
        assert self.kernel is not None
        return self.kernel.clock.now_ns()

    def is_over(self, run: str) -> bool:
        assert self.kernel is not None
        if self.kernel.state.runs.get(RunId(run)) is not None:
            return False
        self._learn()  # the kernel knows it a moment before it is written
        return self._book.runs[run].over

    def as_completed(self, runs: Iterable[str]) -> Iterator[RunResult]:
        """In the order in which they end."""
        left = list(runs)
        while left:
            self.wait(lambda: any(self.is_over(run) for run in left))
            over = next(run for run in left if self.is_over(run))
            left.remove(over)
            yield self.status(over)

    def runs(self) -> list[RunResult]:
        """All that there were, in order."""
        self._learn()
        return [self.status(run) for run in self._book.runs]

    @property
    def notes(self) -> list[tuple[str, str, Mapping[str, Any]]]:
        """What applications have told the log: kind, name and facts."""
        found = [decode(r.head.type, r.head.schema, r.payload) for r in self.store.records]
        return [(e.kind, e.name, e.facts) for e in found if type(e).__name__ == "ExperimentNoted"]  # type: ignore[attr-defined]

    async def _open(self) -> None:
        self._furnish()
        for module in self.stand.workcell.modules:
            self._start_node(module.name)
        self._start_kernel()
        await self._set_up()
        self._people.append(self.loop.create_task(self._act_as_person()))

    def _learn(self) -> None:
        fresh = self.store.records[self._read :]
        self._read += len(fresh)
        for record in fresh:
            event = decode(record.head.type, record.head.schema, record.payload)
            self._names.learn(event)
            self._book.add(event, record.head)

    def _do(self, work: Any) -> Any:
        asyncio.set_event_loop(self.loop)
        try:
            return self.loop.run_until_complete(work)
        finally:
            asyncio.set_event_loop(None)


class VirtualExperiment:
    """As much of an ``Experiment`` as applications need."""

    def __init__(
        self, lab: VirtualLab, name: str, user: str, *, closing: Path | None = None, **payload: Any
    ) -> None:
        self.lab, self.user, self.name, self._number = lab, user, name, 0
        plan = lab.plan(closing, payload) if closing else None
        lab.execute(StartExperiment(name, user, plan, request=name))
        assert lab.kernel is not None
        self.id = str(lab.kernel.state.experiments.requests[name])

    def end(self) -> None:
        self.lab.execute(EndExperiment(ExperimentId(self.id)))

    def submit_all(self, workflow: str | Path, payloads: Iterable[Mapping[str, Any]]) -> list[str]:
        return [self._submit(Path(workflow), payload) for payload in payloads]

    def submit(self, workflow: str | Path, payload: Mapping[str, Any], *, key: str = "") -> str:
        return self._submit(Path(workflow), payload)

    def note(self, kind: str, name: str, **facts: Any) -> None:
        self.lab.execute(NoteExperiment(ExperimentId(self.id), kind, name, dict(facts)))

    def decide(self, name: str, function: Callable[[], Any]) -> Any:
        decided = as_json(function())
        self.note("decision", name, value=decided)
        return decided

    def keep_file(self, content: bytes) -> str:
        self.lab.kept[digest(content)] = content
        return digest(content)

    def _submit(self, workflow: Path, payload: Mapping[str, Any]) -> str:
        lab = self.lab
        self._number += 1
        request = f"{self.name}/{self._number}"
        lab.execute(
            SubmitRun(
                lab.plan(workflow, payload),
                self.user,
                dict(payload),
                experiment=ExperimentId(self.id),
                request=request,
            )
        )
        assert lab.kernel is not None
        run = lab.kernel.state.runs.requests.get(request)
        if run is None:
            raise LabosError(f"{workflow.name} was not taken.")
        return str(run)
