"""The service of a lab for requests from outside: it turns their texts into commands.

Every check is made before the first decision, so that a refused request leaves no trace.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from labos.core.bench import Labware, split_item
from labos.core.canonical import digest
from labos.core.decide.composites import SubmitWithLabware
from labos.core.decide.experiments import (
    EndExperiment,
    LoseExperiment,
    NoteExperiment,
    ResumeExperiment,
    StartExperiment,
)
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.nodes import RecordStops
from labos.core.decide.rights import check_rights, check_role
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation
from labos.core.ids import (
    ExperimentId,
    InterventionId,
    LabwareId,
    ModuleName,
    RunId,
    StationName,
    local,
    workcell_of,
)
from labos.core.model import LabwareSpec, Plan, StationSpec, Workcell
from labos.core.open_experiments import ExperimentStatus
from labos.core.runs import RunSubmitted
from labos.core.structs import make_from
from labos.core.users import Role, find_person
from labos.errors import BadInput, LabosError, NotFound, Refused, StoreError
from labos.http.control import make_run_command
from labos.http.feed import Feed
from labos.http.limits import FileName, Files, FileText
from labos.http.parts import Parts
from labos.http.placing import make_loads, with_loads
from labos.http.repeats import expect_same_experiment, expect_same_run, make_digest_of_request
from labos.http.tail import Tail
from labos.http.viewers import Viewers
from labos.planning.booked import list_without_gap
from labos.planning.certified import check_windows
from labos.runtime.kernel import make_error
from labos.runtime.marks import Marks
from labos.runtime.stop import EVERYTHING, StopReport, resolve_target, stop_modules
from labos.services.interventions import describe_answer
from labos.services.runs import RunHistory, run_history
from labos.services.times import parse_due
from labos.spec import (
    BenchFile,
    Compiled,
    CompiledWorkcell,
    Stock,
    compile_workflow,
    parse_workflow,
)
from labos.spec.findings import Finding, suggest_name, suggest_similar
from labos.spec.labware import load_packaged_labware, make_spec
from labos.spec.stations import Stations

if TYPE_CHECKING:
    from labos.http.bodies import NewExperiment, NewRun, NewRuns
    from labos.http.finding import Finder
    from labos.http.forecasts import Forecasts
    from labos.http.link import KernelLink

SILENCE_S = 30.0
"""An application without a heartbeat for so long counts as lost."""

STORIES_KEPT = 200

LONG_TEXT = 64 * 1024
"""Reading a file with at least so many characters takes a while."""

N = TypeVar("N", ModuleName, StationName)
R = TypeVar("R")


class WorkflowText(msgspec.Struct, frozen=True):
    """A workflow in a request: its text, its name in error messages, and the contents of files that its
    arguments may name."""

    text: FileText
    name: FileName = "workflow"
    files: Files = {}


class PlannedRun(msgspec.Struct, frozen=True):
    """A compiled run that is not submitted yet. ``loads`` is the labware that was placed for it."""

    run: SubmitRun
    loads: tuple[LoadStation, ...]
    findings: tuple[Finding, ...]

    @property
    def command(self) -> SubmitRun | SubmitWithLabware:
        return SubmitWithLabware(self.run, self.loads) if self.loads else self.run


class LabService:
    """Submits, queries and changes; every call raises LabosError with a remedy."""

    def __init__(self, parts: Parts, feed: Feed, viewers: Viewers | None = None) -> None:
        self.viewers = viewers
        if viewers is not None:
            parts.kernel.listeners.append(viewers)
        self.parts, self.feed = parts, feed
        self.kernel = parts.kernel
        self.tail = Tail(parts.store, lambda: parts.kernel.durable)
        parts.kernel.listeners.append(self.tail)
        self.marks: Marks | None = None
        """The log's facts about requests, if the kernel is in this process."""
        self.link: KernelLink | None = None
        """The connection to the kernel, if it is in another process."""
        self.finder: Finder | None = None
        """Answers queries to the search index."""
        self._heard: dict[ExperimentId, float] = {}
        self._stories: dict[str, RunHistory] = {}
        self._cells: dict[str, Workcell] = {}
        self._long_work = asyncio.Semaphore(1)

    async def run_beside(self, size: int, work: Callable[..., R], *args: Any, **named: Any) -> R:
        """Do work on a text of ``size`` characters, for long texts in a thread. Long texts are handled one at
        a time: Python runs one thread at a time, and the kernel needs its share."""
        if size <= LONG_TEXT:
            return await asyncio.to_thread(work, *args, **named)
        async with self._long_work:
            return await asyncio.to_thread(work, *args, **named)

    @cached_property
    def forecasts(self) -> Forecasts:
        """Makes forecasts of the lab."""
        from labos.http.forecasts import Forecasts

        return Forecasts(self)

    def give_up_forecasts(self) -> None:
        """Stop forecasts that are being computed, if any were requested."""
        if "forecasts" in self.__dict__:
            self.forecasts.close()

    # -- workcells ---------------------------------------------------------------------------

    async def apply(self, cell: CompiledWorkcell, actor: str, *, declare: bool) -> None:
        """Set up a workcell, or change it. With ``declare``, stations without a declaration have the content
        that the file gives as stock."""
        stock: dict[StationName, list[str]] = {}
        for item in cell.bench.stock if declare else ():
            stock.setdefault(item.station, []).extend([item.labware] * item.count)
        contents = {name: tuple(types) for name, types in stock.items()} if declare else None
        await self.kernel.execute(ApplyWorkcell(cell.workcell, contents), actor)

    def workcell(self, name: str = "") -> Workcell:
        """An applied workcell, as the log has it; if no name is given, the only one. Raises BadInput."""
        state = self.kernel.state
        known = list(state.lab.workcells)
        if not name:
            if len(known) != 1:
                if not known:
                    raise BadInput("This lab has no workcell yet.", remedy="Give one to `labos up`.")
                raise BadInput(
                    f"This lab has {len(known)} workcells, but none was named.",
                    remedy=f"Name one of {', '.join(known)}.",
                )
            name = known[0]
        if name not in known:
            raise NotFound(
                f"This lab has no workcell {name!r}.", remedy=suggest_name(name, known, "workcell")
            )
        found = state.lab.workcells[name]
        if found not in self._cells:
            self._cells[found] = self.read_workcell(name)
        return self._cells[found]

    def read_workcell(self, name: str) -> Workcell:
        """A workcell as the log has it; empty if it has none of this name."""
        state = self.kernel.state
        return Workcell(
            name,
            state.lab.workcells.get(name, ""),
            tuple(m.spec for n, m in state.modules.by_name.items() if workcell_of(n) == name),
            tuple(s.spec for n, s in state.bench.stations.items() if workcell_of(n) == name),
            tuple(state.lab.labware.get(name, {}).values()),
            state.lab.transfers.get(name, ()),
        )

    def read_bench(self, workcell: str) -> BenchFile:
        """The labware types in the stacks now, and the modules that are not at rest although no run holds
        them."""
        state = self.kernel.state
        away = {
            name: tuple(v for v, at in module.spec.rest.items() if module.find_value(v) not in (at, None))
            for name, module in state.modules.by_name.items()
            if workcell_of(name) == workcell and not state.runs.holders.get(name)
        }
        return BenchFile(
            away_from_rest={name: variables for name, variables in away.items() if variables},
            stock=tuple(
                Stock(name, station.stock[-1], len(station.stock))
                for name, station in self.kernel.state.bench.stations.items()
                if station.stock and workcell_of(name) == workcell
            ),
        )

    def list_labware_types(self) -> list[str]:
        """The labware types that may be placed: those of LabOS and of the lab, those that stations accept,
        and those on the bench."""
        bench = self.kernel.state.bench
        known = {item.type for item in bench.labware.values()} | set(_load_packaged_labware())
        for own in self.kernel.state.lab.labware.values():
            known.update(own)
        for station in bench.stations.values():
            known.update(station.spec.accepts, station.stock)
        return sorted(known)

    def expect_labware(self, labware: str) -> None:
        """Raises NotFound for a type that this lab does not know."""
        known = self.list_labware_types()
        labware = next((part for part in split_item(labware) if part and part not in known), "")
        if labware:
            meant = suggest_similar(labware, known)
            slip = f"{meant} " if meant else ""
            raise NotFound(
                f"This lab knows no labware type {labware!r}.",
                remedy=f"{slip}Known: {', '.join(known)}. A new type is described in a labware file that the "
                "workcell file names under `labware:`.",
            )

    def find_labware_kind(self, item: Labware) -> LabwareSpec | None:
        """The description of a piece's type: from the workcell where it stands, from another workcell, or
        from LabOS; None if there is none."""
        own = self.kernel.state.lab.labware
        here = workcell_of(item.station) if item.station else ""
        cells = [own[name] for name in sorted(own, key=lambda name: (name != here, name))]
        return next(
            (cell[item.type] for cell in (*cells, _load_packaged_labware()) if item.type in cell), None
        )

    # -- runs --------------------------------------------------------------------------------

    async def compile(
        self,
        workflow: WorkflowText,
        payload: dict[str, Any],
        workcell: str,
        loads: Sequence[LoadStation] = (),
        *,
        keep: bool = True,
    ) -> Compiled:
        """``loads`` is the labware that will be placed on the bench before the submission. With ``keep``,
        files and text are stored for the submission. Raises SpecError, SpecErrors, BadInput."""
        cell = self.workcell(await self.find_workcell_for(workflow, workcell))
        bench = with_loads(self.read_bench(cell.name), loads)
        simulated = self.parts.simulated
        descriptions = self.parts.descriptions

        def work() -> Compiled:
            source = parse_workflow(workflow.text, workflow.name)
            compiled = compile_workflow(
                source, payload, cell, descriptions, simulate=simulated, files=workflow.files, bench=bench
            )
            compiled = check_windows(compiled, cell)
            # Stored before an event names them.
            for content in (*compiled.files.values(), workflow.text.encode()) if keep else ():
                self.parts.blobs.put(content)
            return compiled

        return await self.run_beside(len(workflow.text), work)

    async def find_workcell_for(self, workflow: WorkflowText, workcell: str) -> str:
        """The named workcell, else the workflow's; empty if none is needed."""
        if workcell or len(self.kernel.state.lab.workcells) == 1:
            return workcell
        source = await self.run_beside(len(workflow.text), parse_workflow, workflow.text, workflow.name)
        wanted = source.data.get("workcell")
        return wanted if isinstance(wanted, str) else ""

    async def submit(self, asked: NewRun, request: str = "") -> tuple[str, tuple[Finding, ...]]:
        """Queue a run for the requesting user; returns its id and the workflow's warnings. The same
        ``request`` twice is one run; Refused if the two requests differ. The labware that was placed for it
        is recorded together with the run, or not at all."""
        self.expect_role(asked.user, "submitter")  # before anything of it is stored
        self.expect_own(asked.experiment, asked.user)
        files = await asyncio.to_thread(digest_files, asked.workflow.files)
        whole = digest_of_run(asked, files, asked.payload)
        known = self.kernel.state.runs.requests.get(request) if request else None
        if known is not None:
            await self.kernel.flush()
            await asyncio.to_thread(expect_same_run, self.parts.store, request, known, whole)
            return str(known), ()
        planned = await self.plan_run(asked, keep=True, whole=whole, request=request)
        events = await self.kernel.execute(planned.command, asked.user)
        run = next((event.run for event in events if isinstance(event, RunSubmitted)), None)
        if run is None:
            run = self.kernel.state.runs.requests[request]
            await asyncio.to_thread(expect_same_run, self.parts.store, request, run, whole)
        return str(run), (*planned.findings, *self.without_gap(run))

    async def plan_run(self, asked: NewRun, *, keep: bool = False, **given: Any) -> PlannedRun:
        """The requested run, compiled. ``keep`` is as for ``compile``, ``given`` as for ``make_run``."""
        due_at = parse_due(asked.due, self.kernel.clock.now_ns())
        workcell = await self.find_workcell_for(asked.workflow, asked.workcell)
        loads = make_loads(self, asked.place, workcell, asked.user)
        compiled = await self.compile(asked.workflow, asked.payload, workcell, loads, keep=keep)
        run = self.make_run(asked, asked.workflow, compiled, due_at=due_at, **given)
        return PlannedRun(run, tuple(loads), compiled.findings)

    def make_run(
        self,
        asked: NewRun | NewRuns,
        workflow: WorkflowText,
        compiled: Compiled,
        *,
        whole: str = "",
        **given: Any,
    ) -> SubmitRun:
        """The command for a requested run. ``whole`` is the digest of its request; ``given`` are values in
        place of those in the request."""
        return make_from(
            SubmitRun,
            asked,
            plan=compiled.plan,
            others=compiled.others,
            user=find_person(asked.user),
            pins={**self.list_pins(workflow, *compiled.plans), "request": whole},
            **given,
        )

    def without_gap(self, run: RunId) -> list[Finding]:
        """Warnings about bookings of others that leave no time for the run: it would wait for a person."""
        state = self.kernel.state
        known = state.runs.queued.get(run) if state.bookings.open else None
        waits = list_without_gap(state, known, self.kernel.clock.now_ns()) if known is not None else []
        remedies = {wait.reason.sentence: wait.reason.remedy for wait in waits}
        return [
            Finding("warning", f"{sentence[0].upper()}{sentence[1:]}.", remedy=todo)
            for sentence, todo in remedies.items()
        ]

    def expect_own(self, experiment: str, user: str) -> None:
        """Raises Refused for a run in an experiment of another user, as it could use that user's labware."""
        known = self.kernel.state.experiments.open.get(ExperimentId(experiment))
        if known is not None and known.user != find_person(user):
            raise Refused(
                f"The experiment {known.id} is {known.user}'s; {user} cannot submit a run for it.",
                remedy=f"Leave the experiment out, or submit it as {known.user}.",
            )

    def list_pins(self, workflow: WorkflowText, *plans: Plan) -> dict[str, str]:
        """The digests of the parts of a run that follows one of these plans."""
        state = self.kernel.state
        pins = {
            "workflow": digest(workflow.text.encode()),
            "workcell": state.lab.workcells[plans[0].workcell],
        }
        for step in (step for plan in plans for step in plan.steps):
            module = state.modules.by_name.get(step.module)
            if module is not None and module.about:
                pins[f"about:{local(step.module)}"] = module.about
        return pins

    async def change(self, run: str, verb: str, actor: str, *, stay: bool = False, why: str = "") -> None:
        """``cancel``, ``pause`` or ``resume`` a run. ``stay``: a cancelled run's labware stays where it is.
        ``why``: the reason for its cancellation, for the log."""
        if self.kernel.state.runs.get(run) is None:
            await self.read_story(run)  # raises NotFound for an unknown run
        await self.kernel.execute(make_run_command(verb, run, stay, why), actor)

    async def read_story(self, run: str, wait_s: float = 0.0) -> RunHistory:
        """A run according to the log; waits for its end for at most ``wait_s``. Raises NotFound."""
        if wait_s > 0:
            await self.feed.wait_until(lambda: self.kernel.state.runs.get(run) is None, wait_s)
        await self.kernel.flush()
        if run in self._stories:
            return self._stories[run]
        story = await asyncio.to_thread(run_history, self.parts.store, run)
        if story.over:
            self._stories[run] = story
            while len(self._stories) > STORIES_KEPT:
                del self._stories[next(iter(self._stories))]
        return story

    # -- experiments -------------------------------------------------------------------------

    async def start_experiment(self, asked: NewExperiment, request: str = "") -> str:
        """An application begins; from now on it must send a heartbeat at least every ``SILENCE_S``."""
        user, closing = asked.user, asked.closing
        self.expect_role(user, "submitter")
        compiled = await self.compile(closing, asked.payload, asked.workcell) if closing is not None else None
        if compiled is not None and compiled.others:
            raise BadInput(
                f"The closing workflow {compiled.plan.workflow!r} has a choice of modules.",
                remedy="Name one module for each of its steps: a closing workflow must always be possible.",
            )
        plan = compiled.plan if compiled is not None else None
        places = tuple(self.station(place) for place in asked.parking)
        key = request or self.kernel.ids.new()
        command = StartExperiment(
            asked.name, find_person(user), plan, asked.priority, key, places, asked.propose
        )
        requests = self.kernel.state.experiments.requests
        if command.request in requests or not await self.kernel.execute(command, user):
            await self.kernel.flush()
            known = self.kernel.state.experiments.requests[command.request]
            await asyncio.to_thread(expect_same_experiment, self.parts.store, command, known)
        experiment = self.kernel.state.experiments.requests[command.request]
        self.note_heartbeat(experiment, user)
        return str(experiment)

    def expect_role(self, actor: str, needs: Role, cell: str = "") -> None:
        """Raises Forbidden for a user without the role in a workcell (empty: in all of them)."""
        lacks = check_role(self.kernel.state, actor, needs, cell)
        if lacks is not None:
            raise make_error(lacks)

    def note_heartbeat(self, experiment: str, actor: str) -> None:
        """The application is running. Raises Forbidden for another user's experiment: a heartbeat means that
        its sender continues the experiment."""
        self.check_noting(experiment, actor)
        self._heard[ExperimentId(experiment)] = self.parts.clock.monotonic()

    def check_noting(self, experiment: str, actor: str) -> None:
        """Raises Forbidden for a user who may not add to an experiment."""
        wrong = check_rights(self.kernel.state, NoteExperiment(ExperimentId(experiment), "", ""), actor)
        if wrong is not None:
            raise make_error(wrong)

    async def note(
        self, experiment: str, kind: str, name: str, facts: dict[str, Any], actor: str, key: str = ""
    ) -> None:
        self.note_heartbeat(experiment, actor)
        await self.kernel.execute(NoteExperiment(ExperimentId(experiment), kind, name, facts, key), actor)

    async def resume_experiment(self, experiment: str, name: str, actor: str) -> None:
        """An application was started again."""
        await self.kernel.execute(ResumeExperiment(ExperimentId(experiment), name), actor)
        self.note_heartbeat(experiment, actor)

    async def end_experiment(self, experiment: str, why: str, actor: str) -> None:
        """The application has ended; a repetition has no further effect."""
        name = ExperimentId(experiment)
        known = self.kernel.state.experiments.open
        given_out = {f"E{number + 1}" for number in range(self.kernel.state.experiments.named)}
        if name in given_out and name not in known:
            await self.kernel.flush()
            return
        await self.kernel.execute(EndExperiment(name, why), actor)
        self._heard.pop(name, None)

    async def miss_silent(self) -> None:
        """Ask a person about applications without a heartbeat; runs until it is cancelled."""
        while True:
            await asyncio.sleep(1.0)
            now = self.parts.clock.monotonic()
            try:
                experiments = list(self.kernel.state.experiments.open.values())
                for experiment in experiments:
                    silent_s = now - self._heard.setdefault(experiment.id, now)
                    if experiment.status == ExperimentStatus.OPEN and silent_s > SILENCE_S:
                        why = f"no heartbeat for {silent_s:.0f} s"
                        self.kernel.submit(LoseExperiment(experiment.id, why), "labos")
            except StoreError:
                continue

    # -- people and nodes --------------------------------------------------------------------

    async def resolve(self, intervention: str, choice: str, by: str, note: str, result: Any) -> None:
        answer = ResolveIntervention(InterventionId(intervention), choice, by, note, result)
        if answer.intervention not in self.kernel.state.interventions.open:
            await self.kernel.flush()
            if text := await asyncio.to_thread(describe_answer, self.parts.store, intervention):
                raise Refused(text, remedy="See its consequences: labos interventions --all")
        await self.kernel.execute(answer, by)

    async def emergency_stop(self, target: str, by: str) -> StopReport:
        """Stop a module, a workcell or everything (``*``) at once, without reading the log or waiting for it.
        Raises NotFound."""
        registry = self.parts.registry
        known = list(registry.living)
        with contextlib.suppress(LabosError):  # the log may be unreachable
            known += [name for name in self.kernel.state.modules.by_name if name not in known]
        modules = resolve_target(target, known)
        if not modules and target != EVERYTHING:
            raise NotFound(
                f"This lab has no module or workcell {target!r}.",
                remedy=suggest_name(target, map(local, known), "module"),
            )
        report = await stop_modules(self.parts.bus, registry.lab, modules, by)
        with contextlib.suppress(LabosError):  # the nodes report it again with their states
            self.kernel.submit(RecordStops(by, report.stopped, target, report.silent), by)
        return report

    def module(self, name: str) -> ModuleName:
        """A module by its full name, or by its local one if only one module has it. Raises NotFound."""
        names = list(self.kernel.state.modules.by_name)
        found = [known for known in names if name in (known, local(known))]
        return _find_only(found, name, names, "module")

    def labware(self, name: str) -> Labware:
        """A piece of labware on the bench, by its id or its barcode. Raises NotFound."""
        known = self.kernel.state.bench.labware
        name = self.kernel.state.bench.barcodes.get(name, name)
        if name not in known:
            remedy = suggest_name(name, map(str, known), "labware")
            raise NotFound(f"No labware {name!r} stands on the bench.", remedy=remedy)
        return known[LabwareId(name)]

    def station(self, name: str) -> StationName:
        """A station by its full name, its local name or an alias, with or without its module. Raises
        NotFound, BadInput."""
        known = self.kernel.state.bench.stations
        if name in known:
            return StationName(name)
        home, _, written = name.rpartition("/")
        named: dict[str, list[StationSpec]] = {}
        for station, there in known.items():
            if not home or workcell_of(station) == home:
                named.setdefault(workcell_of(station), []).append(there.spec)
        found = [
            match for cell, specs in named.items() for match in Stations(cell, specs).list_matches(written)
        ]
        found = [station for station in found if local(station) == written] or found
        return _find_only(found, name, known, "station")


def _find_only(found: Sequence[N], name: str, known: Iterable[N], what: str) -> N:
    """The only one of those ``found`` under a name. Raises NotFound, BadInput if there are several."""
    if len(found) == 1:
        return found[0]
    if found:
        raise BadInput(f"{name!r} is the name of several {what}s.", remedy=f"Write {found[0]}, for example.")
    remedy = suggest_name(local(name), map(local, known), what)
    raise NotFound(f"This lab has no {what} {name!r}.", remedy=remedy)


def digest_files(files: Mapping[str, bytes]) -> dict[str, str]:
    return {name: digest(content) for name, content in files.items()}


def digest_of_run(asked: NewRun | NewRuns, files: Mapping[str, str], payload: dict[str, Any]) -> str:
    """A digest of the whole request for a run: it shows whether a key stands for the same run. ``files`` are
    the run's files by their digests."""
    return make_digest_of_request(
        *(asked.workflow.text, files, payload, asked.user, asked.workcell, asked.priority, asked.experiment),
        *([asked.place] if asked.place else []),
        *(["propose"] if asked.propose else []),
        *([f"due {asked.due}"] if asked.due else []),
    )


@cache
def _load_packaged_labware() -> Mapping[str, LabwareSpec]:
    """The labware types that come with LabOS."""
    return {name: make_spec(name, kind) for name, kind in load_packaged_labware().items()}
