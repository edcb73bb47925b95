"""An application's experiment as a block of code."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import msgspec

from labos.client._answers import LabUnreachable
from labos.client._calls import plain
from labos.client._lab import LabClient
from labos.client._progress import Progress
from labos.client._results import RunResult
from labos.client._services import Computations
from labos.errors import BadInput, CommitInDoubt, LabosError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from labos.services.compute import Attempts

HEARTBEAT_S = 5.0
LONGEST_WHY = 500


class Experiment:
    """An application's run of runs. Leaving the block ends it; its closing workflow clears away
    what it left parked (at the stations ``parking`` only, if any are named). ``RunFailed`` is raised
    for a run that does not complete, unless ``run(..., check=False)``."""

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
    ) -> None:
        self.lab, self.name, self.user, self.workcell = lab, name, user, workcell
        self._closing, self._payload, self._priority = closing, closing_payload, priority
        self._parking = parking
        self._notes: Counter[bytes] = Counter()
        self._noting = threading.Lock()
        self._computations = Computations(self)
        self._over = threading.Event()
        self._beating: threading.Thread | None = None
        self.id = ""

    def __enter__(self) -> Experiment:
        self.id = self.lab.start_experiment(
            self.name,
            self.user,
            closing=self._closing,
            payload=self._payload,
            workcell=self.workcell,
            priority=self._priority,
            parking=self._parking,
        )
        self._beating = threading.Thread(target=self._beat, name=f"heartbeat-{self.id}", daemon=True)
        self._beating.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            interrupted = kind is not None and not issubclass(kind, Exception)
            self._computations.close(drop=kind is not None, wait=not interrupted)
            if kind is None or issubclass(kind, Exception):
                why = "ended" if error is None else _on_one_line(f"failed: {type(error).__name__}: {error}")
                self.lab.end_experiment(self.id, why, self.user)
        except LabosError:
            if error is None:
                raise
        finally:
            # Somebody who was interrupted is missed by the lab, and a person is asked.
            self._over.set()

    def run(
        self,
        workflow: str | Path,
        payload: Mapping[str, Any] | None = None,
        *,
        check: bool = True,
        progress: Progress = False,
    ) -> RunResult:
        """Run a workflow to its end. Raises RunFailed if it does not complete."""
        options = {"user": self.user, "workcell": self.workcell, "experiment": self.id}
        result = self.lab.run(workflow, payload, progress=progress, **options)
        if check and not result.succeeded:
            raise RunFailed(result)
        return result

    def submit_all(
        self, workflow: str | Path, payloads: Iterable[Mapping[str, Any]], **options: Any
    ) -> list[str]:
        """Queue one run of a workflow for each payload, in order; returns their ids."""
        options = {"user": self.user, "workcell": self.workcell, "experiment": self.id, **options}
        return self.lab.submit_all(workflow, payloads, **options)

    def as_completed(self, runs: Iterable[str], *, check: bool = True) -> Iterator[RunResult]:
        """Runs in the order in which they end. Raises RunFailed at one that does not complete."""
        for result in self.lab.as_completed(runs):
            if check and not result.succeeded:
                raise RunFailed(result)
            yield result

    def note(self, kind: str, name: str, **facts: Any) -> None:
        """Log something of the application's own: loop_started, loop_ended, condition_checked,
        decision, local_compute, compute, flow or publication. A lab that broke off while it was told, or
        whose database did, is asked whether it has heard, and told again if it has not."""
        with self._noting:  # computations are noted from threads of their own
            self._note(kind, name, facts)

    def publish(
        self,
        title: str,
        *,
        about: str = "",
        keywords: Sequence[str] = (),
        creators: Sequence[str] = (),
        files: Iterable[str | Path] | Mapping[str, bytes] = (),
        runs: Sequence[str] = (),
    ) -> None:
        """Make something known that came of the experiment, as one event: `labos find` finds it by its title,
        what it is about, keywords, creators and the names of its files, which the lab keeps. Files are paths,
        or contents by name. Creators are ids of users, or their ORCID iDs: what is published stays in the
        log for ever, so name no persons. Raises BadInput for a file that cannot be read."""
        kept = [
            {"file": name, "sha256": self.keep_file(content), "bytes": len(content)}
            for name, content in _contents(files)
        ]
        listed = {"keywords": list(keywords), "creators": list(creators) or [self.user], "runs": list(runs)}
        self.note("publication", title, title=title, about=about, files=kept, **listed)

    def compute(self, function: Callable[..., Any], *args: Any, where: str = "pool", **named: Any) -> Any:
        """What a function returns that is computed in another process, with an event that names it, the
        digests of its code and arguments, where it ran, how long, and what it returned. ``where`` is local (a
        thread), pool (processes of this computer), parsl or dask. Raises ComputeFailed."""
        return self.submit_compute(function, *args, where=where, **named).result()

    def submit_compute(
        self, function: Callable[..., Any], *args: Any, where: str = "pool", **named: Any
    ) -> Future[Any]:
        """The same, as a future."""
        return self._computations.submit(function, args, named, where)

    def compute_all(
        self, function: Callable[[Any], Any], arguments: Iterable[Any], *, where: str = "pool"
    ) -> list[Any]:
        """What a function returns for each argument, in their order. Raises ComputeFailed."""
        return [each.result() for each in self._computations.submit_all(function, arguments, where)]

    def configure_compute(self, *, attempts: Attempts | None = None, **places: Any) -> None:
        """How often a computation is tried, and what the places need: ``pool=4`` processes,
        ``parsl=parsl.config.Config(…)``, ``dask=distributed.Client(…)``."""
        self._computations.configure(places, attempts)

    def keep_file(self, content: bytes) -> str:
        """Keep a file in the lab; returns its SHA-256, by which ``lab.file`` gives it back."""
        return self.lab.keep_file(self.id, content, self.user)

    def _note(self, kind: str, name: str, facts: Mapping[str, Any]) -> None:
        what = _comparable(kind, name, facts)
        while True:
            try:
                self.lab.note(self.id, kind, name, facts, self.user)
                break
            except (LabUnreachable, CommitInDoubt):
                if self._count_notes(what) > self._notes[what]:
                    break
        self._notes[what] += 1

    def _count_notes(self, what: bytes) -> int:
        """How often the log has this note of this experiment. Raises LabUnreachable."""
        found = self.lab.events(type="experiment.noted", stream=self.id)
        payloads = [event["payload"] for event in found]
        return sum(
            _comparable(note["kind"], note["name"], note.get("facts", {})) == what for note in payloads
        )

    def _beat(self) -> None:
        while not self._over.wait(HEARTBEAT_S):
            try:
                self.lab.heartbeat(self.id)
            except LabosError:
                continue


def _contents(files: Iterable[str | Path] | Mapping[str, bytes]) -> Iterator[tuple[str, bytes]]:
    """Name and content of each file."""
    if isinstance(files, Mapping):
        yield from files.items()
        return
    for path in map(Path, files):
        try:
            yield path.name, path.read_bytes()
        except OSError as error:
            why = error.strerror or error
            raise BadInput(f"{path} cannot be read: {why}.", remedy="Name a file that is there.") from None


def _on_one_line(why: str) -> str:
    """As much of an error's text as the lab takes for a reason."""
    return "".join(char if char.isprintable() else " " for char in why)[:LONGEST_WHY]


def _comparable(kind: str, name: str, facts: Mapping[str, Any]) -> bytes:
    """A note as it can be compared with one that was read back."""
    return msgspec.json.encode((kind, name, facts), enc_hook=plain, order="sorted")


class RunFailed(LabosError):
    """A run did not complete."""

    def __init__(self, result: RunResult) -> None:
        super().__init__(f"Run {result.id} ({result.workflow}) {result.status}: {result.why or 'no reason'}.")
        self.result = result
