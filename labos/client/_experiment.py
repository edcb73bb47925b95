"""An application's experiment as a block of code."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from random import Random  # noqa: TID251 - its seed stands in the log
from types import TracebackType
from typing import TYPE_CHECKING, Any

from labos.client import _flows, _globus, _transfers
from labos.client._batches import BatchRun, list_runs
from labos.client._files import workflow_text
from labos.client._flows import Flow, FlowFailed, FlowResult
from labos.client._lab import LabClient, LabUnreachable
from labos.client._logged import LoggedEvents
from labos.client._progress import Progress
from labos.client._record import ExperimentRecord
from labos.client._replay import Key, ReplayMismatch
from labos.client._results import RunResult
from labos.client._services import Computations
from labos.client._transfers import Place, TransferFailed, Transferred
from labos.errors import BadInput, LabosError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from numpy.random import Generator

    from labos.services.compute import Attempts
    from labos.services.globus import GlobusCarrier, GlobusFlow, GlobusIndex

HEARTBEAT_S = 5.0
LONGEST_WHY = 500


class Experiment(LoggedEvents):
    """One execution of an application, with its runs. Leaving the block ends it; its closing workflow clears
    away labware that it left parked (only at the stations in ``parking``, if given). ``RunFailed`` is raised
    for a run that does not complete, unless ``run(..., check=False)``.

    A killed program continues where it was if it is restarted with ``resume``, the id of its experiment:
    repeated calls are answered from the log. Calls are identified by their order, or by a ``key`` at any
    position. With ``keep_open`` an error of the program leaves the experiment open, so that the program can
    be corrected and can continue. If the lab does not answer, the experiment always stays open.

    A program with several experiments, for example for several plates at once, resumes only the first one.
    The others are ``part_of`` it: the log of the first one lists them.
    """

    def __init__(
        self,
        lab: LabClient,
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
        part_of: Experiment | None = None,
    ) -> None:
        self.lab, self.name, self.user, self.workcell = lab, name, user, workcell
        self._closing, self._payload, self._priority = closing, closing_payload, priority
        self._parking, self._resume, self._keep_open = parking, resume, keep_open
        self._part_of, self._is_resumed = part_of, False
        self._over = threading.Event()
        self._beating: threading.Thread | None = None
        self._random: Random | None = None
        self.id = ""
        self._record = ExperimentRecord(self)
        self._computations = Computations(self._record)
        self._carrier: GlobusCarrier | None = None

    def __enter__(self) -> Experiment:
        if self._resume:
            self._go_on(self._resume)
        elif self._part_of is not None:
            self._go_on(self._part_of._start_part(self.name, self._start))
        else:
            self.id = self._start()
            self._record.begin(self.id)
        past = self._record.past
        self._random = Random(past.seed)
        if past.status == "open":
            self._beating = threading.Thread(
                target=self._send_heartbeats, name=f"heartbeat-{self.id}", daemon=True
            )
            self._beating.start()
        return self

    def _start(self, request: str = "") -> str:
        return self.lab.start_experiment(
            self.name,
            self.user,
            closing=self._closing,
            payload=self._payload,
            workcell=self.workcell,
            priority=self._priority,
            parking=self._parking,
            request=request,
        )

    def _start_part(self, name: str, start: Callable[[str], str]) -> str:
        """The id of an experiment that is part of this one; it is started if the log has none."""
        key = self._record.take("experiment", name)
        return str(self._record.decide(key, name, lambda: start(self._record.request_of(key))))

    def _go_on(self, experiment: str) -> None:
        """Continue an experiment; if it has ended, it is only read. Raises NotFound, Refused."""
        past = self._record.begin(experiment)
        is_resumed = bool(self._resume) or bool(self._part_of and self._part_of._is_resumed)
        if is_resumed and (past.status in ("open", "cancelled") or past.name != self.name):
            self.lab.resume_experiment(experiment, self.name, self.user)
        self.id, self._is_resumed = experiment, is_resumed
        self.lab.warnings = [
            f"{run} of {self.id} has no key of its program, so the program would submit it again."
            for run in past.strays
        ]

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            interrupted = kind is not None and not issubclass(kind, Exception)
            self._computations.close(drop=kind is not None, wait=not interrupted)
            waits = isinstance(error, ReplayMismatch | LabUnreachable)
            if error is not None and (interrupted or waits or self._keep_open):
                if self._part_of is None:
                    error.add_note(f"{self.id} stays open: start the program again with --resume {self.id}.")
            else:
                why = "ended" if error is None else _join_lines(f"failed: {type(error).__name__}: {error}")
                self.lab.end_experiment(self.id, why, self.user)
        except LabosError:
            if error is None:
                raise
        finally:
            # After an interruption there are no heartbeats: the lab notices that, and asks a person.
            self._over.set()

    @property
    def random(self) -> Random:
        """A generator of random numbers that gives the same numbers in a restarted program: its seed comes
        from the log."""
        if self._random is None:
            raise BadInput("The experiment has not started.", remedy="Use it within its `with` block.")
        return self._random

    @property
    def numpy_random(self) -> Generator:
        """The same for numpy, seeded with the next numbers of ``random``: call it once and keep the
        generator."""
        try:
            from numpy.random import default_rng
        except ImportError:
            raise BadInput("numpy is not installed.", remedy='pip install "labos-sdl[analysis]"') from None
        made: Generator = default_rng(self.random.getrandbits(128))
        return made

    def run(
        self,
        workflow: str | Path,
        payload: Mapping[str, Any] | None = None,
        *,
        check: bool = True,
        progress: Progress = False,
        key: str = "",
    ) -> RunResult:
        """Run a workflow to its end. Raises RunFailed if it does not complete, ReplayMismatch if a restarted
        program requested another one."""
        record = self._record
        taken = record.take("run", workflow, key)
        asked = self._make_run(taken, workflow, payload)
        with record.keep_key_on_failure(taken):
            run = record.find_run(taken, asked)
            if run:
                result = self.lab.wait(run, progress=progress)
            else:
                options = {**self._make_options(), "request": asked.key, "progress": progress}
                with record.expect_same(taken, [asked]):
                    result = self.lab.run(asked.workflow, payload, **options)
        if check and not result.succeeded:
            raise RunFailed(result)
        return result

    def submit(
        self, workflow: str | Path, payload: Mapping[str, Any] | None = None, *, key: str = "", **options: Any
    ) -> str:
        """Queue a run of a workflow; returns its id. Options are those of ``LabClient.submit``. Raises
        ReplayMismatch."""
        record = self._record
        taken = record.take("submit", workflow, key)
        with record.keep_key_on_failure(taken):
            asked = self._make_run(taken, workflow, payload)
            known = record.find_run(taken, asked)
            if known:
                self.lab.warnings = []
                return known
            options = {**self._make_options(), **options}
            with record.expect_same(taken, [asked]):
                return self.lab.submit(asked.workflow, payload, request=asked.key, **options)

    def submit_all(
        self,
        workflow: str | Path,
        payloads: Iterable[Mapping[str, Any]],
        *,
        key: str = "",
        **options: Any,
    ) -> list[str]:
        """Queue one run of a workflow for each payload, as ``LabClient.submit_all``; returns their ids.
        Raises ReplayMismatch."""
        record = self._record
        taken = record.take("submit_all", workflow, key)
        request = options.pop("request", "") or record.request_of(taken)
        asked = list_runs(workflow, payloads, request)
        with record.keep_key_on_failure(taken):
            known = {run.number: record.find_run(taken, run) for run in asked}
            new = [run for run in asked if not known[run.number]]
            if len(new) < len(asked):
                options.pop("place", None)  # it was recorded with the first run
            with record.expect_same(taken, new):
                found = self.lab._submit_batches(new, **{**self._make_options(), **options})
        return [known[run.number] or found.pop(0) for run in asked]

    def as_completed(self, runs: Iterable[str], *, check: bool = True) -> Iterator[RunResult]:
        """Runs in the order in which they end. Raises RunFailed for a run that does not complete."""
        for result in self.lab.as_completed(runs):
            if check and not result.succeeded:
                raise RunFailed(result)
            yield result

    def note(self, kind: str, name: str, **facts: Any) -> None:
        """Log a fact of the application: loop_started, loop_ended, condition_checked, decision,
        local_compute, compute, flow, publication or transfer. It is logged once, even if the connection to
        the lab breaks or the program is killed. Raises ReplayMismatch if a decision or condition differs from
        the earlier one."""
        self._record.note(kind, name, facts)

    def publish(
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
        """Publish a result of the experiment, as one event: `labos find` finds it by its title, subject,
        keywords, creators and the names of its files, which the lab stores. Files are paths, or contents by
        name. Creators are ids of users, or their ORCID iDs: a publication stays in the log permanently, so
        name no persons. With an ``index`` of Globus Search it can be found there, too. Raises BadInput for a
        file that cannot be read, GlobusError."""
        taken = self._record.take("publish", title, key)
        kept = [
            {"file": name, "sha256": self.keep_file(content), "bytes": len(content)}
            for name, content in _read_contents(files)
        ]
        listed = {"keywords": list(keywords), "creators": list(creators) or [self.user], "runs": list(runs)}
        facts = {"title": title, "about": about, "files": kept, **listed}
        with self._keep_key(taken):
            self._record.keep(taken, "publication", title, facts)
            if index is not None:
                of = {"experiment": self.id, "application": self.name}
                _globus.ingest(self._record, taken, index, {**facts, **of})

    def decide(self, name: str, function: Callable[[], Any], *, key: str = "") -> Any:
        """Call a function, log its result as a decision, and return it as read from JSON (a tuple is a list).
        In a restarted program the function is not called: the logged result is returned. Use it for every
        value that may differ the next time: a clock, a file, a person's answer. Raises BadInput for a result
        that is not JSON."""
        if not callable(function):
            raise BadInput(f"{name!r} needs a function.", remedy="Give a function: lambda: solver.ask().")
        return self._record.decide(self._record.take("decide", name, key), name, function)

    def compute(
        self, function: Callable[..., Any], *args: Any, where: str = "pool", key: str = "", **named: Any
    ) -> Any:
        """Call a function in another process, and return its result. An event records its name, the digests
        of its code and arguments, where and how long it ran, and its result. ``where`` is local (a thread),
        pool (processes of this computer), parsl, dask or globus. A restarted program does not repeat a
        finished computation. Raises ComputeFailed, ReplayMismatch, PlaceUnavailable."""
        return self.submit_compute(function, *args, where=where, key=key, **named).result()

    def submit_compute(
        self, function: Callable[..., Any], *args: Any, where: str = "pool", key: str = "", **named: Any
    ) -> Future[Any]:
        """The same, as a future."""
        taken = self._record.take("submit_compute", function, key)
        return self._computations.submit(function, args, named, where, taken)

    def compute_all(
        self,
        function: Callable[[Any], Any],
        arguments: Iterable[Any],
        *,
        where: str = "pool",
        key: str = "",
    ) -> list[Any]:
        """The results of a function for each argument, in their order. Raises ComputeFailed, ReplayMismatch,
        PlaceUnavailable."""
        taken = self._record.take("compute_all", function, key)
        with self._keep_key(taken):
            submit = self._computations.submit
            begun = [
                submit(function, (each,), {}, where, f"{taken}-{number}")
                for number, each in enumerate(arguments)
            ]
            return [each.result() for each in begun]

    def run_flow(
        self, flow: Flow | GlobusFlow, *, check: bool = True, key: str = "", **given: Any
    ) -> FlowResult:
        """Carry out the steps of a flow, one after the other, with ``given`` as the ``input`` of its state;
        its start, its end, each step and each further attempt are in the log. A restarted program continues
        at the same step. A flow that is defined in Globus Flows is started there once, and its end awaited.
        Raises FlowFailed if a step fails finally, unless ``check`` is false; ReplayMismatch, GlobusError."""
        taken = self._record.take("run_flow", flow, key)
        with self._keep_key(taken):
            if isinstance(flow, Flow):
                result = _flows.run(self._record, self._computations, taken, flow, given)
            else:
                result = _globus.run_flow(self._record, taken, flow, given)
        if check and result.status != "succeeded":
            raise FlowFailed(result)
        return result

    def transfer(self, source: Place, target: str | Path, *, sha256: str = "", key: str = "") -> Transferred:
        """Copy a file to another place, with an event that has its SHA-256. A place is a path, a URL that
        fsspec knows (extra ``transfer``), or as the source a file of the lab: ``result.files()[0]``. A
        restarted program does not repeat a finished transfer. Between two places
        ``globus://<collection>/<path>``, Globus copies the file (extra ``globus``), and compares the given
        SHA-256. Raises TransferFailed, ReplayMismatch, GlobusError."""
        taken = self._record.take("transfer", target, key)
        with self._keep_key(taken, TransferFailed):
            if _globus.is_globus(source) or _globus.is_globus(target):
                return _globus.transfer(self._record, taken, source, target, self._carrier, sha256)
            return _transfers.transfer(self._record, taken, source, target)

    def configure_compute(self, *, attempts: Attempts | None = None, **places: Any) -> None:
        """Set how often a computation is tried, and the settings of the places: ``pool=4`` processes,
        ``parsl=parsl.config.Config(…)``, ``dask=distributed.Client(…)``,
        ``globus=labos.services.globus.GlobusEndpoint(…)``."""
        self._computations.configure(places, attempts)

    def configure_transfer(self, *, globus: GlobusCarrier) -> None:
        """Set how the program authenticates for transfers: ``globus`` is a
        `labos.services.globus.GlobusCarrier`."""
        self._carrier = globus

    def keep_file(self, content: bytes) -> str:
        """Store a file in the lab; returns its SHA-256, with which ``lab.file`` returns the content."""
        return self._record.keep_file(content)

    def _keep_key(self, key: Key, *failures: type[LabosError]) -> AbstractContextManager[None]:
        """As ``keep_key_on_failure``, for calls that use external services."""
        from labos.services.compute import PlaceUnavailable

        return self._record.keep_key_on_failure(key, PlaceUnavailable, *failures)

    def _make_options(self) -> dict[str, Any]:
        return {"user": self.user, "workcell": self.workcell, "experiment": self.id}

    def _make_run(self, key: Key, workflow: str | Path, payload: Mapping[str, Any] | None) -> BatchRun:
        return BatchRun(0, self._record.request_of(key), workflow_text(workflow, payload), payload or {})

    def _send_heartbeats(self) -> None:
        while not self._over.wait(HEARTBEAT_S):
            try:
                self.lab.heartbeat(self.id)
            except LabosError:
                continue


def _read_contents(files: Iterable[str | Path] | Mapping[str, bytes]) -> Iterator[tuple[str, bytes]]:
    """Name and content of each file."""
    if isinstance(files, Mapping):
        yield from files.items()
        return
    for path in map(Path, files):
        try:
            yield path.name, path.read_bytes()
        except OSError as error:
            why = error.strerror or error
            raise BadInput(f"{path} cannot be read: {why}.", remedy="Name an existing file.") from None


def _join_lines(why: str) -> str:
    """The part of an error's text that the lab accepts as a reason."""
    return "".join(char if char.isprintable() else " " for char in why)[:LONGEST_WHY]


class RunFailed(LabosError):
    """A run did not complete."""

    def __init__(self, result: RunResult) -> None:
        super().__init__(f"Run {result.id} ({result.workflow}) {result.status}: {result.why or 'no reason'}.")
        self.result = result
