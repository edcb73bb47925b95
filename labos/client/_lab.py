"""A lab, over HTTP."""

from __future__ import annotations

import io
import re
import time
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from labos import errors
from labos.client._files import step_text, workflow_text
from labos.client._results import RunResult
from labos.client._tables import rows_of
from labos.clock import Uuid7Ids
from labos.core.canonical import digest
from labos.errors import BadInput, LabosError, LogDamaged
from labos.settings import Settings, find_kernel

if TYPE_CHECKING:
    import httpx
    from PIL.Image import Image

_SHA256 = re.compile("[0-9a-f]{64}")

LONG_POLL_S = 20.0

STOP_S = 5.0
"""How long a lab may take to answer that it has stopped its modules."""


class LabUnreachable(LabosError):
    """No lab answers."""


NEVER_S = 3.0
"""How long to wait for a lab in a folder in which none has ever run."""


class _Told(msgspec.Struct):
    """An error as a lab tells of it."""

    code: str = ""
    error: str = ""
    remedy: str = ""


class LabClient:
    """A lab, over HTTP. Give its ``url``, or its ``home`` folder on this machine.

    Requests are repeated while the lab is silent, for ``patience_s`` in all, as when its kernel is
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
        self.warnings: list[str] = []
        """What the lab remarked on the last submission, one sentence each, with its place."""

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
        BUSY, ERROR, silent, frozen, locked, refused, out, absent) and ``why``."""
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
            _answer(response.status_code, response.content)
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
    ) -> str:
        """Queue a run of a workflow file, of a packaged workflow, or of what ``workflow_text`` or
        ``step_text`` gave; returns its id. ``place`` are stations and the type of labware that was put
        there for it, with what it is (``{"sealed": True}``), recorded with the run or not at all. The same
        ``request`` twice is one run."""
        body = {
            "workflow": workflow_text(workflow, payload),
            "payload": dict(payload or {}),
            "user": user,
            "workcell": workcell,
            "priority": priority,
            "experiment": experiment,
        }
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
        return str(answer["run"])

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

    # -- people ------------------------------------------------------------------------------

    def resolve(self, intervention: str, choice: str, by: str, note: str = "", result: Any = None) -> None:
        """Answer an intervention. ``result`` is what a step that was done has measured, if later
        steps read it."""
        answer = {"choice": choice, "by": by, "note": note, "result": result}
        self._post(f"/interventions/{intervention}", answer)

    def reset(self, module: str, by: str = "somebody") -> RunResult:
        """Bring a module out of its error, and wait for it."""
        return self.wait(self.do(module, "reset", user=by))

    def emergency_stop(self, target: str, by: str = "somebody") -> dict[str, Any]:
        """Stop a module, a workcell or everything (``*``) at once, without the log. ``stopped``
        are the modules that say so, ``silent`` the others. This is no safety function."""
        return self._post("/estop", {"target": target, "by": by}, repeat=True, timeout_s=STOP_S)

    def take_out(self, module: str, why: str, by: str, until_ns: int = 0) -> None:
        """Take a module out of service, until it is put back or until a time (UTC ns)."""
        self._post(f"/nodes/{module}/out-of-service", {"why": why, "by": by, "until": until_ns})

    def put_back(self, module: str, by: str = "somebody") -> None:
        self._post(f"/nodes/{module}/in-service", {"by": by}, repeat=True)

    def trace(self, module: str, by: str = "somebody", *, on: bool = True) -> str:
        """Let a module's node write down every byte on its device's wires, or no more; the file is on the
        computer of the node."""
        return str(self._post(f"/nodes/{module}/trace", {"by": by, "on": on}, repeat=True)["file"])

    def place(self, station: str, labware: str, by: str) -> str:
        """Say that labware of a type was put on an empty station; returns its id."""
        body = {"station": station, "labware": labware, "by": by}
        return str(self._post("/stations/place", body)["labware"])

    def load(self, station: str, labware: str, by: str, *, count: int = 1, lot: str = "") -> list[str]:
        """Say that labware of a type was put on a stack, or into free slots; returns the names it
        got: on a stack it has none until it is taken."""
        body = {"station": station, "labware": labware, "by": by, "count": count, "lot": lot}
        return [str(name) for name in self._post("/stations/load", body)["labware"]]

    def unload(self, station: str, by: str, *, labware: str = "", count: int | None = None) -> dict[str, Any]:
        """Say that labware was taken away: one piece by its name, the topmost ``count``, or all.
        ``labware`` of the answer are the names of those that had one, ``nameless`` counts the rest."""
        body = {"station": station, "by": by, "labware": labware, "count": count}
        return self._post("/stations/unload", body)

    def replenish(
        self,
        module: str,
        resource: str,
        by: str,
        *,
        amount: float = 0.0,
        unit: str = "",
        lot: str = "",
        expires: str = "",
        instead: bool = False,
    ) -> float:
        """Say that more of a resource was put in, as much as there was room for if no ``amount`` is
        named; returns how much. ``unit`` is the resource's own if it is not said; ``expires`` is a
        date, as 2027-05-31; ``instead`` of what was left."""
        pack = {"amount": amount, "unit": unit, "lot": lot, "expires": expires, "instead": instead}
        body = {"resource": resource, "by": by, **pack}
        return float(self._post(f"/nodes/{module}/replenish", body)["amount"])

    def declare(
        self, stations: Mapping[str, Sequence[str]], by: str, *, workcell: str = "", empty: bool = False
    ) -> dict[str, list[str]]:
        """Say what stands at stations, bottom to top; with ``empty``, that those nobody has spoken of
        stand empty. All of it or nothing; returns what was declared."""
        told = {name: list(types) for name, types in stations.items()}
        body = {"stations": told, "by": by, "workcell": workcell, "empty": empty}
        found: dict[str, list[str]] = self._post("/stations/declare", body)["declared"]
        return found

    def apply_workcell(
        self,
        text: str,
        file: str,
        by: str,
        *,
        dry_run: bool = False,
        labware: Mapping[str, bytes] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> dict[str, Any]:
        """Change a workcell to what the text of its file says; with ``dry_run``, only say what that
        would change and what is in the way. ``labware`` holds the labware files that it names, ``files``
        the others, as tables of drivers: the lab reads nothing else."""
        body = {"text": text, "name": file, "by": by, "dry_run": dry_run}
        for key, contents in (("labware", labware), ("files", files)):
            body[key] = {name: b64encode(content).decode() for name, content in (contents or {}).items()}
        return self._post("/workcells", body, repeat=True)

    def teach(
        self,
        module: str,
        station: str,
        pose: Sequence[float],
        by: str,
        why: str = "",
        *,
        labware_type: str = "",
    ) -> int:
        """Say where a manipulator finds a station, with a ``labware_type`` only when it carries that;
        returns the version of the pose."""
        body = {"station": station, "pose": list(pose), "by": by, "why": why, "labware_type": labware_type}
        return int(self._post(f"/modules/{module}/locations", body, repeat=True)["version"])

    def locations(self, module: str) -> dict[str, Any]:
        """The poses of a module by station, with their versions; 0 is the workcell file's. ``types`` are
        those of labware types, where they differ."""
        found: dict[str, Any] = self._get(f"/modules/{module}/locations")["locations"]
        return found

    def enter(self, workcell: str, by: str, why: str = "", *, park: bool = True) -> list[str]:
        """Ask to reach into a workcell: nothing starts there any more. Returns the runs that park its
        arms; ``state()["lab"]["access"]`` says when it is granted, and of which modules nobody knows
        whether they are at rest (``perhaps_moving``)."""
        body = {"by": by, "why": why, "park": park}
        found: list[str] = self._post(f"/workcells/{workcell}/access", body, repeat=True)["parking"]
        return found

    def leave(self, workcell: str, by: str, changed: Sequence[tuple[str, str]] = (), note: str = "") -> None:
        """Say that everybody is out, and what stands at which station now: ``empty``, labware by its
        id, or a type of labware."""
        told = [{"station": station, "what": what} for station, what in changed]
        self._post(f"/workcells/{workcell}/access/end", {"by": by, "note": note, "changed": told})

    def barcode(self, labware: str, barcode: str, by: str, *, replace: bool = False) -> None:
        """Say which barcode labware bears."""
        body = {"barcode": barcode, "by": by, "replace": replace}
        self._post(f"/labware/{labware}/barcode", body, repeat=True)

    def observe(self, station: str, what: str, by: str) -> dict[str, Any]:
        """Say what stands at a station: ``empty``, a number, labware, a labware type; returns what
        follows: ``found``, ``gone``, ``uncertain``, ``answered``, ``asked``."""
        return self._post("/stations/observe", {"station": station, "what": what, "by": by})

    def round(self) -> dict[str, Any]:
        """What is known of a log that has lost its end (``evidence``, ``discovered``), and every station
        with what is ``recorded`` there, whether it was ``said`` on the round and whether it
        ``must_be_said``; without such a log, there are none. ``not_known`` are doors, lids and the like of
        modules."""
        return self._get("/round")

    def say(
        self, by: str, stations: Mapping[str, Sequence[str]] | None = None, as_recorded: Sequence[str] = ()
    ) -> dict[str, Any]:
        """Say on the round what stands at stations, bottom to top, and which are as recorded. Returns what
        was ``said``, what was ``refused`` and why, and what is ``left`` to say."""
        told = {name: list(contents) for name, contents in (stations or {}).items()}
        body = {"by": by, "stations": told, "as_recorded": list(as_recorded)}
        return self._post("/round", body, repeat=True)

    def give(self, labware: str, to: str, by: str, *, force: bool = False, note: str = "") -> None:
        """Hand labware over to ``user:NAME``, ``experiment:E3`` or ``shared``."""
        body = {"to": to, "by": by, "force": force, "note": note}
        self._post(f"/labware/{labware}/owner", body, repeat=True)

    def load_samples(
        self,
        sheet: str | Path,
        by: str,
        *,
        labware: str = "",
        station: str = "",
        replace: bool = False,
    ) -> dict[str, int]:
        """Say which samples are in the wells of plates, by a CSV file; ``labware`` or ``station``
        names the plate where the sheet does not. Returns how many samples each plate has."""
        path = Path(sheet)
        body = {
            "text": _text_of(path),
            "name": str(path),
            "by": by,
            "labware": labware,
            "station": station,
            "replace": replace,
        }
        found: dict[str, int] = self._post("/samples", body, repeat=True)["plates"]
        return found

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
        return _answer(response.status_code, response.content)

    def _request(self, method: str, path: str, *, repeat: bool, **options: Any) -> httpx.Response:
        """Ask until somebody answers. What may not be done twice is repeated only if it
        cannot have arrived."""
        import httpx

        deadline = time.monotonic() + self._patience()
        pause = 0.05
        while True:
            asked = time.monotonic()
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
                # It was there until now, as in a long question: only its silence tries the patience.
                deadline += time.monotonic() - asked
            except LabUnreachable as error:
                why = error
            else:
                if response.status_code != 503 or time.monotonic() > deadline:
                    return response
                if not repeat and _told(response.content).code == "commit_in_doubt":
                    return response
                why = _cannot_write(response.content)
            if time.monotonic() + pause > deadline:
                if isinstance(why, LabUnreachable):
                    raise why
                raise LabUnreachable(
                    f"No lab answers at {self._url} ({why}).", remedy="Start it with `labos up`."
                ) from why
            time.sleep(pause)
            pause = min(pause * 2, 1.0)

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


def _text_of(path: Path) -> str:
    """A file that a person wrote. Raises BadInput."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(f"The file {path} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise BadInput(f"The file {path} is not text.", remedy="Save it as CSV in UTF-8.") from None


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


def _cannot_write(content: bytes) -> LabUnreachable:
    """What is told of a lab that is there and cannot write, with the lab's own reason and remedy."""
    told = _told(content)
    reason = f": {told.error}" if told.error else "."
    return LabUnreachable(f"The lab cannot write its log at the moment{reason}", remedy=told.remedy)


def _told(content: bytes) -> _Told:
    """The error that the lab told of; its fields are empty if it told of none."""
    try:
        return msgspec.json.decode(content, type=_Told)
    except msgspec.MsgspecError:
        return _Told()


def _remark(finding: Mapping[str, Any]) -> str:
    fields = ("message", "file", "line", "column", "field", "remedy")
    message, *place = (finding[name] for name in fields)
    return str(errors.SpecError(message, **dict(zip(fields[1:], place, strict=True))))


def _errors() -> dict[str, type[LabosError]]:
    """Error classes by their code; those with fields of their own come back as their parents."""
    found: dict[str, type[LabosError]] = {"spec_errors": BadInput, "spec_error": BadInput}
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, LabosError) and kind.__init__ is LabosError.__init__:
            code = "".join(f"_{c.lower()}" if c.isupper() and at else c.lower() for at, c in enumerate(name))
            found[code] = kind
    return found


def _shown(file: str | Mapping[str, Any]) -> str:
    return str(file.get("file", file.get("sha256", ""))) if isinstance(file, Mapping) else file
