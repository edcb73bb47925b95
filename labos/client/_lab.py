"""A lab, over HTTP."""

from __future__ import annotations

import base64
import io
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from labos import errors
from labos.client._accounts import AccountCalls
from labos.client._answers import LabUnreachable, answer_of, cannot_write, problem_in
from labos.client._approvals import ApprovalCalls
from labos.client._bench import BenchCalls
from labos.client._bookings import BookingCalls
from labos.client._campaigns import CampaignCalls
from labos.client._files import step_text, workflow_text
from labos.client._people import PeopleCalls
from labos.client._results import RunResult
from labos.client._tables import rows_of
from labos.client._token import find_token, place_of, trusted_by
from labos.clock import Uuid7Ids
from labos.core.canonical import digest
from labos.errors import BadInput, LogDamaged
from labos.settings import Settings, find_kernel

if TYPE_CHECKING:
    import httpx
    from PIL.Image import Image

_SHA256 = re.compile("[0-9a-f]{64}")

API = "/api/v1"

LONG_POLL_S = 20.0

IN_DOUBT = ("commit_in_doubt", "kernel_away")
"""What was asked may have been done: only what may be done twice is repeated."""

NEVER_S = 3.0
"""How long to wait for a lab in a folder in which none has ever run."""


class LabClient(BenchCalls, BookingCalls, ApprovalCalls, CampaignCalls, AccountCalls, PeopleCalls):
    """A lab, over HTTP. Give its ``url``, or its ``home`` folder on this machine.

    Requests are repeated while the lab is silent, for ``patience_s`` in all, as when its kernel is
    restarted; submissions carry an idempotency key, so that nothing is done twice.
    Every call raises LabosError as the lab did, LabUnreachable when nobody answers.

    In a lab with users it shows a ``token``: the one given, else that of LABOS_TOKEN or of the file that
    LABOS_TOKEN_FILE names, else what `labos login` has kept. A service account may act on ``behalf`` of a
    person.
    """

    def __init__(
        self,
        url: str = "",
        *,
        home: str | Path | None = None,
        patience_s: float = 30.0,
        token: str = "",
        behalf: str = "",
    ) -> None:
        self._home = None if url else Settings.of(home).home
        self._url = url.rstrip("/")
        self._patience_s = patience_s
        self._token, self._behalf = token, behalf
        self._http = self._open_http()
        self._ids = Uuid7Ids()
        self.warnings: list[str] = []
        """What the lab remarked on the last submission, one sentence each, with its place."""
        self.approval = ""
        """Why the last submission waits for an approval; empty if it does not."""

    def _open_http(self) -> httpx.Client:
        import httpx

        timeout = httpx.Timeout(LONG_POLL_S + 40.0, connect=5.0)
        return httpx.Client(timeout=timeout, verify=trusted_by(self._home) or True)

    @property
    def token_place(self) -> str:
        """How this lab is called in the file of tokens: its folder, or its address."""
        return place_of(self._url, self._home)

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

    def ask_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, str]]:
        """What the nodes of these modules, or of all, answer at this moment: ``name``, ``answer`` (IDLE,
        BUSY, ERROR, silent, frozen, refused, out, absent) and ``why``."""
        found: list[dict[str, str]] = self._get("/nodes", module=list(modules))["modules"]
        return found

    def check_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, Any]]:
        """As ``ask_nodes``; each that answers also has ``checked``: its ``driver`` with ``version``, its
        ``labos`` and ``protocol``, whether it is ``simulated``, the ``unit`` (serial number) it is pinned to,
        and what its device ``sees``, or ``sees_nothing``: why not. Nothing moves."""
        found: list[dict[str, Any]] = self._get("/nodes", module=list(modules), check=1)["modules"]
        return found

    def inventory(self) -> dict[str, Any]:
        """What is left, of which lots, and which run would be the first to find too little."""
        return self._get("/inventory")

    def status(self, run: str, *, wait_s: float = 0.0) -> RunResult:
        """A run as it is now, or at its end if that comes within ``wait_s``."""
        return msgspec.convert(self._get(f"/runs/{run}", wait=wait_s), RunResult)

    def runs(self, after: int = 0, *, ended: int = 0) -> dict[str, Any]:
        """A page of the ``runs`` that are alive, with the ``position`` after which to go on while there are
        ``more``; and as many that ``ended`` last."""
        return self._get("/runs", after=after, ended=ended)

    def file(self, file: str | Mapping[str, Any], *, first: int = 0, last: int | None = None) -> bytes:
        """The content of a file that a step has returned: ``result["picture"]``, say, or its SHA-256. With
        ``first`` and ``last``, the bytes from the one to the other, both counted from 0 and included. Raises
        NotFound, BadInput, LogDamaged if the whole content does not have the SHA-256 that it should have."""
        name = str(file.get("sha256", "") if isinstance(file, Mapping) else file)
        if not _SHA256.fullmatch(name):
            raise BadInput(
                f"{name[:80]!r} names no file.",
                remedy="Give what stands in a result, or 64 hexadecimal digits.",
            )
        part = bool(first) or last is not None
        headers = {"range": f"bytes={first}-{'' if last is None else last}"} if part else {}
        response = self._request("GET", f"/files/{name}", repeat=True, headers=headers)
        if response.status_code == 416:
            raise BadInput(f"The file {name} has no bytes {first} to {'its end' if last is None else last}.")
        if response.status_code >= 400:
            answer_of(response.status_code, response.content)
        if not part and digest(response.content) != name:
            raise LogDamaged(f"The lab sent another content for the file {name}.", position=0)
        return bytes(response.content)

    def image(self, file: str | Mapping[str, Any]) -> Image:
        """A picture that a step has returned (``result.result("Take picture")``), as Pillow has it. Raises as
        ``file``, and BadInput for a file that is no picture."""
        from PIL import Image, UnidentifiedImageError

        content = self.file(file)
        try:
            image = Image.open(io.BytesIO(content))
            image.load()
        except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
            raise BadInput(f"{_shown(file)} is no picture ({error}).", remedy="Use file(…).") from None
        return image

    def table(self, file: str | Mapping[str, Any]) -> list[dict[str, Any]]:
        """The rows of a table that a step has returned (CSV, by comma, semicolon or tab, with its columns'
        names in the first line); what is a number is one. Raises as ``file``, and BadInput for a file that is
        no such table."""
        try:
            return rows_of(self.file(file).decode("utf-8-sig"))
        except (UnicodeDecodeError, ValueError) as error:
            raise BadInput(f"{_shown(file)} is no table ({error}).", remedy="Use file(…).") from None

    def events(
        self, after: int = 0, *, follow: bool = False, wait_s: float | None = None, **filters: Any
    ) -> Iterator[dict[str, Any]]:
        """Committed events in order; with ``follow``, for ever. ``wait_s`` is how long each request waits for
        one: not at all, and ``LONG_POLL_S`` with ``follow``, if it is not given. Filters: type, stream,
        correlation, actor, mentions."""
        usual_s = LONG_POLL_S if follow else 0.0
        while True:
            page = self._get("/events", after=after, wait=usual_s if wait_s is None else wait_s, **filters)
            yield from page["events"]
            if page["position"] <= after and not follow:
                return
            after = max(page["position"], after)

    def page_of_events(self, asked: Mapping[str, Any]) -> bytes:
        """A page of events as the lab sends it, with the position from which to go on."""
        response = self._request("GET", "/events", repeat=True, params=dict(asked))
        if response.status_code >= 400:
            answer_of(response.status_code, response.content)
        return bytes(response.content)

    # -- runs --------------------------------------------------------------------------------

    def submit(
        self,
        workflow: str | Path | Mapping[str, Any],
        payload: Mapping[str, Any] | None = None,
        *,
        user: str,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[tuple[str, str] | tuple[str, str, Mapping[str, bool]]] = (),
        request: str = "",
        propose: bool = False,
    ) -> str:
        """Queue a run of a workflow file, of a packaged workflow, or of what ``workflow_text`` or
        ``step_text`` gave; returns its id. ``place`` are stations and the type of labware that was put
        there for it, with what it is (``{"sealed": True}``), recorded with the run or not at all. The same
        ``request`` twice is one run. With ``propose`` it waits for an approval, whatever the policy says."""
        body: dict[str, Any] = {
            "workflow": workflow_text(workflow, payload),
            "payload": dict(payload or {}),
            "user": user,
            "workcell": workcell,
            "priority": priority,
            "experiment": experiment,
        }
        if propose:
            body["propose"] = True
        if place:
            body["place"] = [
                dict(zip(("station", "labware", "variables"), entry, strict=False)) for entry in place
            ]
        answer = self._post(
            "/runs",
            body,
            request=request or self._ids.new(),
        )
        self.warnings = [_remark(finding) for finding in answer.get("warnings", ())]
        self._note_approval(answer)
        return str(answer["run"])

    def _note_approval(self, answer: Mapping[str, Any]) -> None:
        self.approval = str(answer.get("approval", ""))
        self.warnings += [self.approval] if self.approval else []

    def do(self, module: str, action: str, args: Mapping[str, Any] | None = None, **options: Any) -> str:
        """Queue one action on one module, as a run of its own; returns the run's id. Options are
        those of ``submit``."""
        workcell = options.pop("workcell", "") or module.rpartition("/")[0]
        return self.submit(step_text(module, action, args or {}), workcell=workcell, **options)

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

    def cancel(self, run: str, by: str = "somebody", *, stay: bool = False, why: str = "") -> None:
        """End a run when what is in flight has ended. Its labware goes the way out that its workflow has
        under ``on_cancel``; if there is none, or if it is to ``stay``, it stays where it is. ``why`` is a
        word about it for the log."""
        self._post(f"/runs/{run}/cancel", {"by": by, "stay": stay, "why": why}, repeat=True)

    def pause(self, run: str, by: str = "somebody", *, why: str = "") -> None:
        """Start no more steps of it until it is resumed; ``why`` is a word about that for the log."""
        self._post(f"/runs/{run}/pause", {"by": by, "why": why}, repeat=True)

    def resume(self, run: str, by: str = "somebody") -> None:
        self._post(f"/runs/{run}/resume", {"by": by}, repeat=True)

    def control(
        self, verb: str, target: str, by: str, *, why: str = "", stay: bool = False
    ) -> dict[str, Any]:
        """``pause``, ``resume`` or ``cancel`` a run, an experiment, a module, a workcell or the ``lab``.
        Returns what was meant (``kind``, ``target``) and which ``runs`` were cancelled."""
        return self._post(
            f"/control/{verb}", {"target": target, "by": by, "why": why, "stay": stay}, repeat=True
        )

    def reset(self, module: str, by: str = "somebody") -> RunResult:
        """Bring a module out of its error, and wait for it."""
        return self.wait(self.do(module, "reset", user=by))

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
        parking: Sequence[str] = (),
        propose: bool = False,
    ) -> str:
        """Prefer ``Experiment``. An experiment that is not heard of for 30 s is asked about."""
        body = {
            "name": name,
            "user": user,
            "closing": None if closing is None else workflow_text(closing, payload),
            "payload": dict(payload or {}),
            "workcell": workcell,
            "priority": priority,
            "parking": list(parking),
            **({"propose": True} if propose else {}),
        }
        answer = self._post("/experiments", body, request=self._ids.new())
        self.warnings = []
        self._note_approval(answer)
        return str(answer["experiment"])

    def note(self, experiment: str, kind: str, name: str, facts: Mapping[str, Any], user: str = "") -> None:
        body = {"kind": kind, "name": name, "facts": dict(facts)}
        self._post(f"/experiments/{experiment}/notes", body, user=user)

    def keep_file(self, experiment: str, content: bytes, user: str = "") -> str:
        """Keep a file of an experiment; returns its SHA-256."""
        body = {"content": base64.b64encode(content).decode()}
        answer = self._post(f"/experiments/{experiment}/files", body, user=user, repeat=True)
        return str(answer["sha256"])

    def heartbeat(self, experiment: str, user: str = "") -> None:
        self._post(f"/experiments/{experiment}/heartbeat", {}, user=user, repeat=True)

    def end_experiment(self, experiment: str, why: str = "ended", user: str = "") -> None:
        self._post(f"/experiments/{experiment}/end", {"why": why}, user=user, repeat=True)

    # -- inside ------------------------------------------------------------------------------

    def _get(self, path: str, **params: Any) -> dict[str, Any]:
        return self._ask("GET", path, params=params, repeat=True)

    def _fetch(self, path: str, **params: Any) -> bytes:
        response = self._request("GET", path, repeat=True, params=params)
        if response.status_code >= 400:
            answer_of(response.status_code, response.content)
        return bytes(response.content)

    def _post(
        self,
        path: str,
        body: Any,
        *,
        request: str = "",
        user: str = "",
        repeat: bool = False,
        timeout_s: float | None = None,
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
            **({"timeout": timeout_s} if timeout_s else {}),
        )

    def _ask(self, method: str, path: str, *, repeat: bool, **options: Any) -> dict[str, Any]:
        """As ``_request``, what the lab said. Raises the error that it told of."""
        response = self._request(method, path, repeat=repeat, **options)
        return answer_of(response.status_code, response.content)

    def _request(self, method: str, path: str, *, repeat: bool, **options: Any) -> httpx.Response:
        """Ask until somebody answers. What may not be done twice is repeated only if it
        cannot have arrived."""
        import httpx

        deadline = time.monotonic() + self._patience()
        pause = 0.05
        own = options.pop("headers", {})
        while True:
            asked = time.monotonic()
            try:
                base = self._base()
                headers = {**own, **self._shown(base)}
                response = self._http.request(method, base + API + path, headers=headers, **options)
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
                # It was there until now, as in a long question: only its silence tries the patience.
                deadline += time.monotonic() - asked
            except LabUnreachable as error:
                why = error
            else:
                if response.status_code != 503 or time.monotonic() > deadline:
                    return response
                if not repeat and problem_in(response.content).code in IN_DOUBT:
                    return response
                why = cannot_write(response.content)
            if time.monotonic() + pause > deadline:
                if isinstance(why, LabUnreachable):
                    raise why
                raise LabUnreachable(
                    f"No lab answers at {self._url} ({why}).", remedy="Start it with `labos up`."
                ) from why
            time.sleep(pause)
            pause = min(pause * 2, 1.0)

    def _shown(self, base: str) -> dict[str, str]:
        """The headers that say who asks. Raises BadInput for a file of tokens that others can read."""
        token = self._token or find_token(base, self._home)
        shown = {"authorization": f"Bearer {token}"} if token else {}
        return shown | ({"labos-on-behalf-of": self._behalf} if self._behalf else {})

    def _patience(self) -> float:
        """How long to ask a lab that does not answer: not for long where there never was one."""
        never = self._home is not None and not (self._home / "kernel.json").exists()
        return min(self._patience_s, NEVER_S) if never else self._patience_s

    def _base(self) -> str:
        """Where the lab is now: a restarted one may have another address."""
        if self._home is not None:
            found = find_kernel(self._home)
            if found is None:
                raise LabUnreachable(f"No lab runs in {self._home}.", remedy="Start it with `labos up`.")
            self._url = found.url
        return self._url


def _remark(finding: Mapping[str, Any]) -> str:
    fields = ("message", "file", "line", "column", "field", "remedy")
    message, *place = (finding[name] for name in fields)
    return str(errors.SpecError(message, **dict(zip(fields[1:], place, strict=True))))


def _shown(file: str | Mapping[str, Any]) -> str:
    return str(file.get("file", file.get("sha256", ""))) if isinstance(file, Mapping) else file
