"""The client for programs that work with asyncio: written by tests/docs/client_twin.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from labos.client._experiment import Experiment
from labos.client._generated.twin_calls import AsyncCalls
from labos.client._lab import LabClient
from labos.client._threads import Threads

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
    from concurrent.futures import Future
    from contextlib import AbstractAsyncContextManager
    from pathlib import Path
    from random import Random
    from types import TracebackType
    from typing import Any

    from numpy.random import Generator
    from PIL.Image import Image

    from labos.client._flows import Flow, FlowResult
    from labos.client._logged import Loop
    from labos.client._progress import Progress
    from labos.client._results import RunResult
    from labos.client._runs import Put
    from labos.client._transfers import Place, Transferred
    from labos.services.compute import Attempts
    from labos.services.globus import GlobusCarrier, GlobusFlow, GlobusIndex
    from labos.services.results import Readings


class AsyncLabClient(AsyncCalls):
    """As ``LabClient``, which stands behind it as ``sync``, with methods to be awaited. A call that is
    cancelled may have been done. What a ``RunResult`` asks the lab for, it asks without waiting for others:
    use ``readings``, ``file`` and the like of this class in its place."""

    def __init__(
        self,
        url: str = "",
        *,
        home: str | Path | None = None,
        patience_s: float = 30.0,
        token: str = "",
        behalf: str = "",
    ) -> None:
        self.sync = LabClient(url, home=home, patience_s=patience_s, token=token, behalf=behalf)
        self.threads = Threads()

    async def __aenter__(self) -> AsyncLabClient:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.close()

    @property
    def warnings(self) -> list[str]:
        return self.sync.warnings

    @property
    def approval(self) -> str:
        return self.sync.approval

    async def amend_campaign(self, campaign: str, by: str, **changes: Any) -> dict[str, Any]:
        """Let a campaign go on under other terms."""
        return await self.threads.call(self.sync.amend_campaign, campaign, by, **changes)

    async def apply_workcell(
        self,
        text: str,
        file: str,
        by: str,
        *,
        dry_run: bool = False,
        labware: Mapping[str, bytes] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> dict[str, Any]:
        """Change a workcell to what the text of its file says; with ``dry_run``, only say what that would
        change and what is in the way."""
        return await self.threads.call(
            self.sync.apply_workcell, text, file, by, dry_run=dry_run, labware=labware, files=files
        )

    async def approvals(self) -> list[dict[str, Any]]:
        """What waits for an approval, the oldest first: ``subject``, ``digest``, ``why`` and the like."""
        return await self.threads.call(self.sync.approvals)

    def as_completed(
        self, runs: Iterable[str], *, timeout_s: float | None = None
    ) -> AsyncIterator[RunResult]:
        """Runs in the order in which they end; those that have ended come first."""
        return self.threads.iterate(self.sync.as_completed(runs, timeout_s=timeout_s))

    async def ask_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, str]]:
        """What the nodes of these modules, or of all, answer at this moment: ``name``, ``answer`` (IDLE,
        BUSY, ERROR, silent, frozen, refused, out, absent) and ``why``."""
        return await self.threads.call(self.sync.ask_nodes, modules)

    async def check(self, workflow: str | Path | Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """What a run of a workflow would be: its ``steps``, its ``demand``, why it would wait for an
        ``approval`` or be refused (``refusal``)."""
        return await self.threads.call(self.sync.check, workflow, **options)

    async def check_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, Any]]:
        """As ``ask_nodes``; each that answers also has ``checked``: its ``driver`` with ``version``, its
        ``labos`` and ``protocol``, whether it is ``simulated``, the ``unit`` (serial number) it is pinned
        to, and what its device ``sees``, or ``sees_nothing``: why not."""
        return await self.threads.call(self.sync.check_nodes, modules)

    async def clone_campaign(
        self, campaign: str, by: str, *, request: str = "", **changes: Any
    ) -> dict[str, Any]:
        """Submit a campaign once more, also one that has ended; returns as ``submit_campaign``."""
        return await self.threads.call(self.sync.clone_campaign, campaign, by, request=request, **changes)

    async def close(self) -> None:
        self.threads.give_up()
        await self.threads.call(self.sync.close)

    async def control(
        self, verb: str, target: str, by: str, *, why: str = "", stay: bool = False
    ) -> dict[str, Any]:
        """``pause``, ``resume`` or ``cancel`` a run, an experiment, a module, a workcell or the
        ``lab``."""
        return await self.threads.call(self.sync.control, verb, target, by, why=why, stay=stay)

    async def do(
        self, module: str, action: str, args: Mapping[str, Any] | None = None, **options: Any
    ) -> str:
        """Queue one action on one module, as a run of its own; returns the run's id."""
        return await self.threads.call(self.sync.do, module, action, args, **options)

    def events(
        self, after: int = 0, *, follow: bool = False, wait_s: float | None = None, **filters: Any
    ) -> AsyncIterator[dict[str, Any]]:
        """Committed events in order; with ``follow``, for ever."""
        return self.threads.iterate_pages(
            self.sync._pages_of_events(after, follow=follow, wait_s=wait_s, **filters)
        )

    async def file(self, file: str | Mapping[str, Any], *, first: int = 0, last: int | None = None) -> bytes:
        """The content of a file that a step has returned: ``result["picture"]``, say, or its SHA-256."""
        return await self.threads.call(self.sync.file, file, first=first, last=last)

    async def forecast_campaign(
        self, campaign: str | Path | Mapping[str, Any], *, user: str
    ) -> dict[str, Any]:
        """Check a campaign file as ``submit_campaign`` does, and submit nothing: what it asks of the lab
        as ``estimate``, and what it would bring as ``forecast``."""
        return await self.threads.call(self.sync.forecast_campaign, campaign, user=user)

    async def forecast_run(self, workflow: str | Path | Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """When a run of a workflow would start and end, and what it would bring, as ``forecast``."""
        return await self.threads.call(self.sync.forecast_run, workflow, **options)

    async def image(self, file: str | Mapping[str, Any]) -> Image:
        """A picture that a step has returned (``result.result("Take picture")``), as Pillow has it."""
        return await self.threads.call(self.sync.image, file)

    async def leave(
        self, workcell: str, by: str, changed: Sequence[tuple[str, str]] = (), note: str = ""
    ) -> None:
        """Say that everybody is out, and what stands at which station now: ``empty``, labware by its id,
        or a type of labware."""
        await self.threads.call(self.sync.leave, workcell, by, changed, note)

    async def load_samples(
        self, sheet: str | Path, by: str, *, labware: str = "", station: str = "", replace: bool = False
    ) -> dict[str, int]:
        """Say which samples are in the wells of plates, by a CSV file; ``labware`` or ``station`` names
        the plate where the sheet does not."""
        return await self.threads.call(
            self.sync.load_samples, sheet, by, labware=labware, station=station, replace=replace
        )

    async def page_of_events(self, asked: Mapping[str, Any]) -> bytes:
        """A page of events as the lab sends it, with the position from which to go on."""
        return await self.threads.call(self.sync.page_of_events, asked)

    async def readings(self, run: str) -> Readings:
        """What a run measured, well by well, each value with the sample that was in its well; as a table
        by ``to_frame()`` (pandas) and ``to_csv()``."""
        return await self.threads.call(self.sync.readings, run)

    async def reset(self, module: str, by: str = "somebody") -> RunResult:
        """Bring a module out of its error, and wait for it."""
        return await self.threads.wait(self.sync.reset, module, by)

    async def run(
        self,
        workflow: str | Path | Mapping[str, Any],
        payload: Mapping[str, Any] | None = None,
        *,
        progress: Progress = False,
        **options: Any,
    ) -> RunResult:
        """``submit``, then ``wait``."""
        return await self.threads.wait(self.sync.run, workflow, payload, progress=progress, **options)

    async def start_experiment(
        self,
        name: str,
        user: str,
        *,
        closing: str | Path | None = None,
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        parking: Sequence[str] = (),
        propose: bool = False,
        request: str = "",
    ) -> str:
        """Prefer ``Experiment``."""
        return await self.threads.call(
            self.sync.start_experiment,
            name,
            user,
            closing=closing,
            payload=payload,
            workcell=workcell,
            priority=priority,
            parking=parking,
            propose=propose,
            request=request,
        )

    async def status(self, run: str, *, wait_s: float = 0.0) -> RunResult:
        """A run as it is now, or at its end if that comes within ``wait_s``."""
        return await self.threads.wait(self.sync.status, run, wait_s=wait_s)

    async def submit(
        self,
        workflow: str | Path | Mapping[str, Any],
        payload: Mapping[str, Any] | None = None,
        *,
        user: str,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[Put] = (),
        request: str = "",
        propose: bool = False,
        due: str = "",
    ) -> str:
        """Queue a run of a workflow file, of a packaged workflow, or of what ``workflow_text`` or
        ``step_text`` gave; returns its id."""
        return await self.threads.call(
            self.sync.submit,
            workflow,
            payload,
            user=user,
            workcell=workcell,
            priority=priority,
            experiment=experiment,
            place=place,
            request=request,
            propose=propose,
            due=due,
        )

    async def submit_all(
        self,
        workflow: str | Path | Mapping[str, Any],
        payloads: Iterable[Mapping[str, Any]],
        *,
        user: str,
        request: str = "",
        **options: Any,
    ) -> list[str]:
        """Queue one run of a workflow for each payload, in order; returns their ids."""
        return await self.threads.call(
            self.sync.submit_all, workflow, payloads, user=user, request=request, **options
        )

    async def submit_campaign(
        self,
        campaign: str | Path | Mapping[str, Any],
        *,
        user: str,
        dry_run: bool = False,
        request: str = "",
        propose: bool = False,
    ) -> dict[str, Any]:
        """Check a campaign file with its table and workflow, row by row, and submit it."""
        return await self.threads.call(
            self.sync.submit_campaign, campaign, user=user, dry_run=dry_run, request=request, propose=propose
        )

    async def table(self, file: str | Mapping[str, Any]) -> list[dict[str, Any]]:
        """The rows of a table that a step has returned (CSV, by comma, semicolon or tab, with its
        columns' names in the first line); what is a number is one."""
        return await self.threads.call(self.sync.table, file)

    @property
    def token_place(self) -> str:
        return self.sync.token_place

    async def wait(
        self, run: str, *, timeout_s: float | None = None, progress: Progress = False
    ) -> RunResult:
        """The run at its end, or as it is when the time is over."""
        return await self.threads.wait(self.sync.wait, run, timeout_s=timeout_s, progress=progress)


class AsyncExperiment:
    """As ``Experiment``, which stands behind it as ``sync``, with methods to be awaited::

    async with AsyncLabClient(home="lab") as lab, AsyncExperiment(lab, "mix", "ada") as experiment:
        result = await experiment.run("mix.yaml")
    """

    def __init__(
        self,
        lab: AsyncLabClient,
        name: str,
        user: str,
        *,
        closing: str | Path | None = None,
        closing_payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        parking: Sequence[str] = (),
        resume: str = "",
        keep_open: bool = False,
        part_of: AsyncExperiment | None = None,
    ) -> None:
        self.lab = lab
        self.sync: Experiment = Experiment(
            lab.sync,
            name,
            user,
            closing=closing,
            closing_payload=closing_payload,
            workcell=workcell,
            priority=priority,
            parking=parking,
            resume=resume,
            keep_open=keep_open,
            part_of=part_of.sync if part_of is not None else None,
        )
        self.threads = lab.threads

    async def __aenter__(self) -> AsyncExperiment:
        try:
            await self.threads.wait(self.sync.__enter__)
        except BaseException:
            self.sync._over.set()  # nobody is in the block: no heartbeat says so
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.threads.wait(self.sync.__exit__, kind, error, trace)

    @property
    def name(self) -> str:
        return self.sync.name

    @property
    def user(self) -> str:
        return self.sync.user

    @property
    def workcell(self) -> str:
        return self.sync.workcell

    @property
    def id(self) -> str:
        return self.sync.id

    def as_completed(self, runs: Iterable[str], *, check: bool = True) -> AsyncIterator[RunResult]:
        """Runs in the order in which they end."""
        return self.threads.iterate(self.sync.as_completed(runs, check=check))

    async def compute(
        self, function: Callable[..., Any], *args: Any, where: str = "pool", key: str = "", **named: Any
    ) -> Any:
        """What a function returns that is computed in another process, with an event that names it, the
        digests of its code and arguments, where it ran, how long, and what it returned."""
        return await self.threads.wait(
            self.sync.compute,
            function,
            *args,
            where=where,
            key=self.sync._take("compute", function, key),
            **named,
        )

    async def compute_all(
        self, function: Callable[[Any], Any], arguments: Iterable[Any], *, where: str = "pool", key: str = ""
    ) -> list[Any]:
        """What a function returns for each argument, in their order."""
        return await self.threads.wait(
            self.sync.compute_all,
            function,
            arguments,
            where=where,
            key=self.sync._take("compute_all", function, key),
        )

    async def configure_compute(self, *, attempts: Attempts | None = None, **places: Any) -> None:
        """How often a computation is tried, and what the places need: ``pool=4`` processes,
        ``parsl=parsl.config.Config(…)``, ``dask=distributed.Client(…)``,
        ``globus=labos.services.globus.GlobusEndpoint(…)``."""
        await self.threads.wait(self.sync.configure_compute, attempts=attempts, **places)

    async def configure_transfer(self, *, globus: GlobusCarrier) -> None:
        """How the program is let in where it transfers files: ``globus`` is a
        `labos.services.globus.GlobusCarrier`."""
        await self.threads.wait(self.sync.configure_transfer, globus=globus)

    async def decide(self, name: str, function: Callable[[], Any], *, key: str = "") -> Any:
        """What a function returns, as JSON gives it back (a tuple is a list), logged as a decision."""
        return await self.threads.wait(
            self.sync.decide, name, function, key=self.sync._take("decide", name, key)
        )

    async def keep_file(self, content: bytes) -> str:
        """Keep a file in the lab; returns its SHA-256, by which ``lab.file`` gives it back."""
        return await self.threads.wait(self.sync.keep_file, content)

    async def log_check(self, condition: str, result: bool, *, loop: str = "", **facts: Any) -> bool:
        """A condition was checked, perhaps that of a loop; returns the result."""
        return await self.threads.wait(self.sync.log_check, condition, result, loop=loop, **facts)

    async def log_decision(self, name: str, value: Any, **facts: Any) -> None:
        """Something was decided."""
        await self.threads.wait(self.sync.log_decision, name, value, **facts)

    async def log_flow(self, flow: str, *, flow_id: str = "", **facts: Any) -> None:
        """A flow of other services was started, by Globus Flows, say."""
        await self.threads.wait(self.sync.log_flow, flow, flow_id=flow_id, **facts)

    async def log_local_compute(self, function: str, **facts: Any) -> None:
        """Something was computed in this program."""
        await self.threads.wait(self.sync.log_local_compute, function, **facts)

    async def log_loop_end(self, loop: str, **facts: Any) -> None:
        """A loop has ended."""
        await self.threads.wait(self.sync.log_loop_end, loop, **facts)

    async def log_loop_start(self, loop: str, **facts: Any) -> None:
        """A loop begins."""
        await self.threads.wait(self.sync.log_loop_start, loop, **facts)

    async def log_publication(self, what: str, **facts: Any) -> None:
        """Something was published."""
        await self.threads.wait(self.sync.log_publication, what, **facts)

    async def log_remote_compute(self, function: str, **facts: Any) -> None:
        """Something was computed elsewhere, by Globus Compute, say."""
        await self.threads.wait(self.sync.log_remote_compute, function, **facts)

    def loop(self, name: str, **facts: Any) -> AbstractAsyncContextManager[AsyncLoop]:
        """A loop, as a block: its start and its end are logged, also an end by an error."""
        return self.threads.block_of(self.sync.loop(name, **facts), AsyncLoop)

    async def note(self, kind: str, name: str, **facts: Any) -> None:
        """Log something of the application's own: loop_started, loop_ended, condition_checked, decision,
        local_compute, compute, flow, publication or transfer."""
        await self.threads.wait(self.sync.note, kind, name, **facts)

    @property
    def numpy_random(self) -> Generator:
        return self.sync.numpy_random

    async def publish(
        self,
        title: str,
        *,
        about: str = "",
        keywords: Sequence[str] = (),
        creators: Sequence[str] = (),
        files: Iterable[str | Path] | Mapping[str, bytes] = (),
        runs: Sequence[str] = (),
        index: GlobusIndex | None = None,
        key: str = "",
    ) -> None:
        """Make something known that came of the experiment, as one event: `labos find` finds it by its
        title, what it is about, keywords, creators and the names of its files, which the lab keeps."""
        await self.threads.wait(
            self.sync.publish,
            title,
            about=about,
            keywords=keywords,
            creators=creators,
            files=files,
            runs=runs,
            index=index,
            key=self.sync._take("publish", title, key),
        )

    @property
    def random(self) -> Random:
        return self.sync.random

    async def run(
        self,
        workflow: str | Path,
        payload: Mapping[str, Any] | None = None,
        *,
        check: bool = True,
        progress: Progress = False,
        key: str = "",
    ) -> RunResult:
        """Run a workflow to its end."""
        return await self.threads.wait(
            self.sync.run,
            workflow,
            payload,
            check=check,
            progress=progress,
            key=self.sync._take("run", workflow, key),
        )

    async def run_flow(
        self, flow: Flow | GlobusFlow, *, check: bool = True, key: str = "", **given: Any
    ) -> FlowResult:
        """Carry out the steps of a flow, one after the other, with what is ``given`` as ``input`` of its
        state; its start, its end, each step and each further attempt are in the log."""
        return await self.threads.wait(
            self.sync.run_flow, flow, check=check, key=self.sync._take("run_flow", flow, key), **given
        )

    async def submit(
        self, workflow: str | Path, payload: Mapping[str, Any] | None = None, *, key: str = "", **options: Any
    ) -> str:
        """Queue a run of a workflow; returns its id."""
        return await self.threads.wait(
            self.sync.submit, workflow, payload, key=self.sync._take("submit", workflow, key), **options
        )

    async def submit_all(
        self, workflow: str | Path, payloads: Iterable[Mapping[str, Any]], *, key: str = "", **options: Any
    ) -> list[str]:
        """Queue one run of a workflow for each payload, in order; returns their ids."""
        return await self.threads.wait(
            self.sync.submit_all,
            workflow,
            payloads,
            key=self.sync._take("submit_all", workflow, key),
            **options,
        )

    async def submit_compute(
        self, function: Callable[..., Any], *args: Any, where: str = "pool", key: str = "", **named: Any
    ) -> Future[Any]:
        """The same, as a future."""
        return await self.threads.wait(
            self.sync.submit_compute,
            function,
            *args,
            where=where,
            key=self.sync._take("submit_compute", function, key),
            **named,
        )

    async def transfer(
        self, source: Place, target: str | Path, *, sha256: str = "", key: str = ""
    ) -> Transferred:
        """Copy a file to another place, with an event that has its SHA-256."""
        return await self.threads.wait(
            self.sync.transfer, source, target, sha256=sha256, key=self.sync._take("transfer", source, key)
        )


class AsyncLoop:
    """As ``Loop``, with methods to be awaited."""

    def __init__(self, sync: Loop, threads: Threads) -> None:
        self.sync = sync
        self.threads = threads

    @property
    def name(self) -> str:
        return self.sync.name

    @property
    def facts(self) -> dict[str, Any]:
        return self.sync.facts

    async def check(self, condition: str, result: bool, **facts: Any) -> bool:
        """Log that a condition of the loop was checked; returns the result: ``if loop.check(…):
        break``."""
        return await self.threads.call(self.sync.check, condition, result, **facts)

    async def report(self, **facts: Any) -> None:
        """What the end of the loop will tell."""
        await self.threads.call(self.sync.report, **facts)
