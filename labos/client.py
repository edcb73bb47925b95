"""What applications import: a lab to talk to, and an experiment as a block of code.

::

    lab = LabClient(home="lab")
    with Experiment(lab, "color picker", "bo", closing="cp_trashplate") as experiment:
        experiment.run("cp_newplate")
        result = experiment.run("cp_mixcolor", payload)
        experiment.note("decision", "next colors", colors=[1, 2, 3])

Nothing of the kernel is imported here: an application runs wherever the lab can be reached.
"""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from labos import errors
from labos.clock import Uuid7Ids
from labos.errors import BadInput, LabosError, NotFound
from labos.settings import Settings, find_kernel

HEARTBEAT_S = 5.0
LONG_POLL_S = 20.0
LARGEST_FILE = 64 * 1024 * 1024


class StepResult(msgspec.Struct, frozen=True):
    """A step as the log tells it; times in UTC nanoseconds, 0 if not yet."""

    key: str
    module: str
    action: str
    state: str
    result: Any = None
    error: str = ""
    requested_at: int = 0
    ended_at: int = 0


class RunResult(msgspec.Struct, frozen=True):
    """A run as the log tells it. ``status``: queued, active, paused, cancelling, completed,
    failed or cancelled."""

    id: str
    workflow: str
    user: str
    status: str
    why: str = ""
    experiment: str = ""
    submitted_at: int = 0
    started_at: int = 0
    ended_at: int = 0
    steps: list[StepResult] = []

    @property
    def over(self) -> bool:
        return self.status in ("completed", "failed", "cancelled")

    @property
    def succeeded(self) -> bool:
        return self.status == "completed"

    def result(self, step: str) -> Any:
        """What the step of that name gave back. Raises NotFound."""
        for found in self.steps:
            if found.key == step:
                return found.result
        raise NotFound(f"Run {self.id} has no step {step!r}.")


class LabUnreachable(LabosError):
    """No lab answers."""


class LabClient:
    """A lab, over HTTP. Give its ``url``, or its ``home`` folder on this machine.

    Requests are repeated for ``patience_s`` while the lab does not answer, as when its kernel is
    restarted; submissions carry an idempotency key, so that nothing is done twice.
    Every call raises LabosError as the lab did, LabUnreachable when nobody answers.
    """

    def __init__(self, url: str = "", *, home: str | Path | None = None, patience_s: float = 30.0) -> None:
        import httpx

        self._home = None if url else Settings.of(home).home
        self._url = url.rstrip("/")
        self._patience_s = patience_s
        self._http = httpx.Client(timeout=httpx.Timeout(LONG_POLL_S + 40.0, connect=5.0))
        self._ids = Uuid7Ids()

    def close(self) -> None:
        self._http.close()

    def __enter__(self) -> LabClient:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # -- questions ---------------------------------------------------------------------------

    def health(self) -> dict[str, Any]:
        return self._get("/health")

    def state(self, *, waits: bool = True) -> dict[str, Any]:
        """Everything that is alive: modules, stations, labware, runs, interventions."""
        return self._get("/state", waits=int(waits))

    def status(self, run: str, *, wait_s: float = 0.0) -> RunResult:
        """A run as it is now, or at its end if that comes within ``wait_s``."""
        return msgspec.convert(self._get(f"/runs/{run}", wait=wait_s), RunResult)

    def events(
        self, after: int = 0, *, follow: bool = False, wait_s: float = LONG_POLL_S, **filters: Any
    ) -> Iterator[dict[str, Any]]:
        """Committed events in order; with ``follow``, for ever. Filters: type, stream,
        correlation, actor, mentions."""
        while True:
            page = self._get("/events", after=after, wait=wait_s if follow else 0, **filters)
            yield from page["events"]
            if page["position"] <= after and not follow:
                return
            after = max(page["position"], after)

    # -- runs --------------------------------------------------------------------------------

    def submit(
        self,
        workflow: str | Path,
        payload: Mapping[str, Any] | None = None,
        *,
        user: str,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        request: str = "",
    ) -> str:
        """Queue a run of a workflow file or of a packaged workflow; returns its id. The same
        ``request`` twice is one run."""
        answer = self._post(
            "/runs",
            {
                "workflow": workflow_text(workflow, payload),
                "payload": dict(payload or {}),
                "user": user,
                "workcell": workcell,
                "priority": priority,
                "experiment": experiment,
            },
            request=request or self._ids.new(),
        )
        return str(answer["run"])

    def wait(self, run: str, *, timeout_s: float | None = None) -> RunResult:
        """The run at its end, or as it is when the time is over."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left = LONG_POLL_S if deadline is None else max(deadline - time.monotonic(), 0.0)
            result = self.status(run, wait_s=min(left, LONG_POLL_S))
            if result.over or left <= 0:
                return result

    def run(
        self, workflow: str | Path, payload: Mapping[str, Any] | None = None, **options: Any
    ) -> RunResult:
        """``submit``, then ``wait``."""
        return self.wait(self.submit(workflow, payload, **options))

    def cancel(self, run: str, by: str = "somebody") -> None:
        """End a run when what is in flight has ended; its labware stays where it is."""
        self._post(f"/runs/{run}/cancel", {"by": by}, repeat=True)

    def pause(self, run: str, by: str = "somebody") -> None:
        self._post(f"/runs/{run}/pause", {"by": by}, repeat=True)

    def resume(self, run: str, by: str = "somebody") -> None:
        self._post(f"/runs/{run}/resume", {"by": by}, repeat=True)

    # -- people ------------------------------------------------------------------------------

    def resolve(self, intervention: str, choice: str, by: str, note: str = "") -> None:
        """Answer an intervention."""
        self._post(f"/interventions/{intervention}", {"choice": choice, "by": by, "note": note})

    def reset(self, module: str) -> None:
        """Bring a module out of its error."""
        self._post(f"/nodes/{module}/reset", {})

    def place(self, station: str, labware: str, by: str) -> str:
        """Say that labware of a type was put on an empty station; returns its id."""
        body = {"station": station, "labware": labware, "by": by}
        return str(self._post("/stations/place", body)["labware"])

    # -- experiments -------------------------------------------------------------------------

    def start_experiment(
        self,
        name: str,
        user: str,
        *,
        closing: str | Path | None = None,
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
    ) -> str:
        """Prefer ``Experiment``. An experiment that is not heard of for 30 s is asked about."""
        body = {
            "name": name,
            "user": user,
            "closing": None if closing is None else workflow_text(closing, payload),
            "payload": dict(payload or {}),
            "workcell": workcell,
            "priority": priority,
        }
        return str(self._post("/experiments", body, request=self._ids.new())["experiment"])

    def note(self, experiment: str, kind: str, name: str, facts: Mapping[str, Any], user: str = "") -> None:
        body = {"kind": kind, "name": name, "facts": dict(facts)}
        self._post(f"/experiments/{experiment}/notes", body, user=user)

    def heartbeat(self, experiment: str) -> None:
        self._post(f"/experiments/{experiment}/heartbeat", {}, repeat=True)

    def end_experiment(self, experiment: str, why: str = "ended", user: str = "") -> None:
        self._post(f"/experiments/{experiment}/end", {"why": why}, user=user, repeat=True)

    # -- inside ------------------------------------------------------------------------------

    def _get(self, path: str, **params: Any) -> dict[str, Any]:
        return self._ask("GET", path, params=params, repeat=True)

    def _post(
        self, path: str, body: Any, *, request: str = "", user: str = "", repeat: bool = False
    ) -> dict[str, Any]:
        headers = {"content-type": "application/json"}
        if request:
            headers["idempotency-key"] = request
        if user:
            headers["labos-user"] = user
        return self._ask(
            "POST",
            path,
            content=msgspec.json.encode(body),
            headers=headers,
            repeat=repeat or bool(request),
        )

    def _ask(self, method: str, path: str, *, repeat: bool, **options: Any) -> dict[str, Any]:
        """Ask until somebody answers. What may not be done twice is repeated only if it
        cannot have arrived."""
        import httpx

        deadline = time.monotonic() + self._patience_s
        pause = 0.05
        while True:
            try:
                response = self._http.request(method, self._base() + path, **options)
            except (httpx.ConnectError, httpx.ConnectTimeout) as error:
                why: Exception = error
            except httpx.TransportError as error:
                if not repeat:
                    raise LabUnreachable(
                        f"The lab broke off while it was asked ({type(error).__name__}); whether it was done "
                        "is not known.",
                        remedy="Look with `labos log`.",
                    ) from error
                why = error
            except LabUnreachable as error:
                why = error
            else:
                if response.status_code != 503 or time.monotonic() > deadline:
                    return _answer(response.status_code, response.content)
                why = LabUnreachable("The lab cannot write its log at the moment.")
            if time.monotonic() + pause > deadline:
                if isinstance(why, LabUnreachable):
                    raise why
                raise LabUnreachable(
                    f"No lab answers at {self._url} ({why}).", remedy="Start it with `labos up`."
                ) from why
            time.sleep(pause)
            pause = min(pause * 2, 1.0)

    def _base(self) -> str:
        """Where the lab is now: a restarted one may have another address."""
        if self._home is not None:
            found = find_kernel(self._home)
            if found is None:
                raise LabUnreachable(f"No lab runs in {self._home}.", remedy="Start it with `labos up`.")
            self._url = found.url
        return self._url


class Experiment:
    """An application's run of runs. Leaving the block ends it; its closing workflow clears away
    what it left parked. ``RunFailed`` is raised for a run that does not complete, unless
    ``run(..., check=False)``."""

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
    ) -> None:
        self.lab, self.name, self.user, self.workcell = lab, name, user, workcell
        self._closing, self._payload, self._priority = closing, closing_payload, priority
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
        )
        self._beating = threading.Thread(target=self._beat, name=f"heartbeat-{self.id}", daemon=True)
        self._beating.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None or issubclass(kind, Exception):
                why = "ended" if error is None else f"failed: {type(error).__name__}: {error}"
                self.lab.end_experiment(self.id, why, self.user)
        except LabosError:
            if error is None:
                raise
        finally:
            # Somebody who was interrupted is missed by the lab, and a person is asked.
            self._over.set()

    def run(
        self, workflow: str | Path, payload: Mapping[str, Any] | None = None, *, check: bool = True
    ) -> RunResult:
        """Run a workflow to its end. Raises RunFailed if it does not complete."""
        result = self.lab.run(workflow, payload, user=self.user, workcell=self.workcell, experiment=self.id)
        if check and not result.succeeded:
            raise RunFailed(result)
        return result

    def note(self, kind: str, name: str, **facts: Any) -> None:
        """Log something of the application's own: loop_started, loop_ended, condition_checked,
        decision, local_compute, compute, flow or publication."""
        self.lab.note(self.id, kind, name, facts, self.user)

    def _beat(self) -> None:
        while not self._over.wait(HEARTBEAT_S):
            try:
                self.lab.heartbeat(self.id)
            except LabosError:
                continue


class RunFailed(LabosError):
    """A run did not complete."""

    def __init__(self, result: RunResult) -> None:
        super().__init__(f"Run {result.id} ({result.workflow}) {result.status}: {result.why or 'no reason'}.")
        self.result = result


# -- workflows as text ---------------------------------------------------------------------------


def workflow_text(workflow: str | Path, payload: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A workflow file, or a packaged workflow by name, with the files beside it that its
    arguments or the payload name. Raises BadInput, NotFound."""
    path = Path(workflow)
    if not path.is_file():
        if path.suffix or len(path.parts) > 1:
            raise NotFound(f"There is no workflow file {str(workflow)!r}.", remedy="Check its path.")
        from labos.spec.library import find_spec

        path = find_spec("workflows", str(workflow))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"The workflow {str(workflow)!r} cannot be read: {error}.") from None
    files = {
        name: base64.b64encode(content).decode() for name, content in _files_beside(path, text, payload or {})
    }
    return {"text": text, "name": str(path), "files": files}


def _files_beside(path: Path, text: str, payload: Mapping[str, Any]) -> Iterator[tuple[str, bytes]]:
    import yaml

    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError):
        return  # the lab says what is wrong with it, and where
    folder = path.resolve().parent
    for name in sorted({*_texts(data), *_texts(payload)}):
        if "\n" in name or len(name) > 255:
            continue
        try:
            file = (folder / name).resolve()
            if file.is_relative_to(folder) and file.is_file() and file.stat().st_size <= LARGEST_FILE:
                yield name, file.read_bytes()
        except (OSError, ValueError):
            continue


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)


def _answer(status: int, content: bytes) -> dict[str, Any]:
    """What the lab said. Raises the error it told of."""
    try:
        data = msgspec.json.decode(content)
    except msgspec.MsgspecError:
        data = None
    if not isinstance(data, dict):
        raise LabUnreachable(
            f"What answers is no lab (status {status}).", remedy="Check the address of the lab."
        )
    if status < 400:
        return data
    kind = _errors().get(str(data.get("code")), LabosError)
    message, remedy = str(data.get("error")), str(data.get("remedy", ""))
    raise kind(message, remedy=remedy)


def _errors() -> dict[str, type[LabosError]]:
    """Error classes by their code; those with fields of their own come back as their parents."""
    found: dict[str, type[LabosError]] = {"spec_errors": BadInput, "spec_error": BadInput}
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, LabosError) and kind.__init__ is LabosError.__init__:
            code = "".join(f"_{c.lower()}" if c.isupper() and at else c.lower() for at, c in enumerate(name))
            found[code] = kind
    return found
