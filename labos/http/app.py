"""The routes. Every answer is given when what it tells is on disk."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from itertools import islice
from typing import Any, TypeVar

import msgspec
import structlog
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from labos.core.decide.labware import NameBarcode
from labos.core.decide.teach import TeachLocation
from labos.core.envelope import Record
from labos.core.ids import LabwareId, local
from labos.errors import BadInput, LabosError
from labos.http.access import Told, end_access, request_access
from labos.http.declare import declare_bench
from labos.http.errors import body_of, status_of
from labos.http.samples import register_samples
from labos.http.service import LabService, WorkflowText
from labos.http.sight import give, observe
from labos.http.stock import Load, Refill, Unload, load, replenish, unload
from labos.http.views import lab_view
from labos.http.workcells import apply_workcell
from labos.ports import LogQuery
from labos.services.inventory import inventory
from labos.services.times import iso_time, with_iso_times

MAX_BODY = 96 * 1024 * 1024
LONGEST_WAIT_S = 60.0
KEEP_ALIVE_S = 10.0
PAGE = 1000

T = TypeVar("T")
_log = structlog.get_logger(__name__)


class NewRun(msgspec.Struct, forbid_unknown_fields=True):
    workflow: WorkflowText
    user: str
    payload: dict[str, Any] = {}
    workcell: str = ""
    priority: int = 0
    experiment: str = ""


class NewExperiment(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    user: str
    closing: WorkflowText | None = None
    parking: list[str] = []
    payload: dict[str, Any] = {}
    workcell: str = ""
    priority: int = 0


class Note(msgspec.Struct, forbid_unknown_fields=True):
    kind: str
    name: str
    facts: dict[str, Any] = {}


class End(msgspec.Struct, forbid_unknown_fields=True):
    why: str = "ended"


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    choice: str
    by: str
    note: str = ""
    result: Any = None


class Placed(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    labware: str
    by: str


class Emptied(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    by: str


class Barcode(msgspec.Struct, forbid_unknown_fields=True):
    barcode: str
    by: str
    replace: bool = False


class Seen(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    by: str
    what: str = ""


class Given(msgspec.Struct, forbid_unknown_fields=True):
    to: str
    by: str
    force: bool = False
    note: str = ""


class Sheet(msgspec.Struct, forbid_unknown_fields=True):
    text: str
    by: str
    name: str = "sheet"
    labware: str = ""
    station: str = ""
    replace: bool = False


class WorkcellText(msgspec.Struct, forbid_unknown_fields=True):
    text: str
    by: str
    name: str = "workcell"
    dry_run: bool = False


class Taught(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    pose: list[float]
    by: str
    why: str = ""


class Entering(msgspec.Struct, forbid_unknown_fields=True):
    by: str
    why: str = ""
    park: bool = True


class Leaving(msgspec.Struct, forbid_unknown_fields=True):
    by: str
    note: str = ""
    changed: list[Told] = []


class Declared(msgspec.Struct, forbid_unknown_fields=True):
    by: str
    stations: dict[str, list[str]] = {}
    workcell: str = ""
    empty: bool = False


class By(msgspec.Struct, forbid_unknown_fields=True):
    by: str = "somebody"


class Stop(msgspec.Struct, forbid_unknown_fields=True):
    target: str
    by: str = "somebody"


class Outage(msgspec.Struct, forbid_unknown_fields=True):
    why: str
    by: str
    until: int = 0


def create_app(service: LabService) -> Starlette:
    """The application over one lab."""
    api = _Api(service)

    def route(path: str, handler: Callable[[Request], Awaitable[Response]], method: str = "GET") -> Route:
        return Route(path, handler, methods=[method])

    return Starlette(
        routes=[
            route("/health", api.health),
            route("/state", api.state),
            route("/events", api.events),
            route("/inventory", api.inventory),
            route("/runs", api.runs),
            route("/runs", api.submit, "POST"),
            route("/runs/{run}", api.run),
            route("/runs/{run}/{verb:str}", api.change, "POST"),
            route("/experiments", api.start_experiment, "POST"),
            route("/experiments/{experiment}/end", api.end_experiment, "POST"),
            route("/experiments/{experiment}/notes", api.note, "POST"),
            route("/experiments/{experiment}/heartbeat", api.heartbeat, "POST"),
            route("/interventions/{intervention}", api.resolve, "POST"),
            route("/estop", api.emergency_stop, "POST"),
            route("/nodes/{module:path}/out-of-service", api.take_out, "POST"),
            route("/nodes/{module:path}/in-service", api.put_back, "POST"),
            route("/stations/place", api.place, "POST"),
            route("/stations/empty", api.empty, "POST"),
            route("/stations/load", api.load, "POST"),
            route("/stations/unload", api.unload, "POST"),
            route("/nodes/{module:path}/replenish", api.replenish, "POST"),
            route("/stations/observe", api.observe, "POST"),
            route("/stations/declare", api.declare, "POST"),
            route("/modules/{module:path}/locations", api.locations),
            route("/modules/{module:path}/locations", api.teach, "POST"),
            route("/workcells", api.apply_workcell, "POST"),
            route("/workcells/{workcell}/access", api.enter, "POST"),
            route("/workcells/{workcell}/access/end", api.leave, "POST"),
            route("/labware/{labware}/barcode", api.barcode, "POST"),
            route("/labware/{labware}/owner", api.give, "POST"),
            route("/samples", api.samples, "POST"),
        ],
        exception_handlers={
            LabosError: _labos_error,  # type: ignore[dict-item]
            HTTPException: _http_error,  # type: ignore[dict-item]
            Exception: _surprise,
        },
    )


class _Api:
    def __init__(self, service: LabService) -> None:
        self.service = service
        self.kernel = service.kernel
        self.feed = service.feed

    # -- questions ---------------------------------------------------------------------------

    async def health(self, request: Request) -> Response:
        kernel = self.kernel
        state = kernel.state
        return _json(
            {
                "status": "failed" if kernel.failed.done() else "ok",
                "lab": state.lab.id,
                "name": state.lab.name,
                "epoch": state.lab.epoch,
                "position": kernel.durable,
                "simulated": self.service.parts.simulated,
                "pace": state.lab.pace,
                "broken_drivers": dict(self.service.parts.broken_drivers),
            }
        )

    async def state(self, request: Request) -> Response:
        parts = self.service.parts
        view = lab_view(
            self.kernel,
            simulated=parts.simulated,
            rejected={str(name): why for name, why in parts.registry.rejected.items()},
            supervised=parts.supervised.nodes if parts.supervised is not None else {},
            waits=request.query_params.get("waits", "1") != "0",
        )
        await self.kernel.written()
        return _json(view)

    async def inventory(self, request: Request) -> Response:
        now = self.kernel.clock.now_ns()
        found = with_iso_times(msgspec.to_builtins(inventory(self.kernel.state, now, iso_time(now)[:10])))
        await self.kernel.written()
        return _json(found)

    async def runs(self, request: Request) -> Response:
        """Runs that are alive; with ``ended=N``, the last N that have ended too."""
        state = self.kernel.state
        alive = [*state.runs.active, *state.runs.queued]
        await self.kernel.written()
        ended = _number(request, "ended", 0)
        over: list[str] = []
        if ended:
            query = LogQuery(types=("run.completed", "run.failed", "run.cancelled"), last=ended)
            over = [record.head.stream for record in await self._read(query, ended)]
        stories = [await self.service.story(run) for run in [*over, *alive]]
        return _json({"runs": [_story(story) for story in stories]})

    async def run(self, request: Request) -> Response:
        wait_s = min(_seconds(request, "wait"), LONGEST_WAIT_S)
        return _json(_story(await self.service.story(request.path_params["run"], wait_s)))

    async def events(self, request: Request) -> Response:
        """Committed events in order: one page, or a stream of server-sent events (``follow=1``).
        Filters: after, type (may be repeated), stream, correlation, actor, mentions, last."""
        params = request.query_params
        query = LogQuery(
            after=_number(request, "after", 0),
            types=tuple(params.getlist("type")),
            streams=tuple(params.getlist("stream")),
            correlation=params.get("correlation", ""),
            actor=params.get("actor", ""),
            mentions=params.get("mentions", ""),
            last=_number(request, "last", 0) or None,
        )
        if params.get("follow", "0") in ("1", "true"):
            return StreamingResponse(self._stream(query), media_type="text/event-stream")
        wait_s = min(_seconds(request, "wait"), LONGEST_WAIT_S)
        upto = self.kernel.durable
        if wait_s and upto <= query.after:
            await self.feed.until(lambda: self.kernel.durable > query.after, wait_s)
            upto = self.kernel.durable
        records = await self._read(msgspec.structs.replace(query, upto=upto), PAGE)
        seen = records[-1].head.position if len(records) == PAGE else upto
        return _json({"events": [_event(record) for record in records], "position": seen})

    async def _stream(self, query: LogQuery) -> AsyncIterator[bytes]:
        while not self.feed.closed:
            upto = self.kernel.durable
            while query.after < upto:
                records = await self._read(msgspec.structs.replace(query, upto=upto), PAGE)
                for record in records:
                    data = msgspec.json.encode(_event(record))
                    yield b"id: %d\ndata: %b\n\n" % (record.head.position, data)
                seen = records[-1].head.position if len(records) == PAGE else upto
                query = msgspec.structs.replace(query, after=seen, last=None)
            if self.kernel.durable <= query.after:
                yield b": %d\n\n" % query.after
                await self.feed.change(KEEP_ALIVE_S)

    async def _read(self, query: LogQuery, most: int) -> list[Record]:
        return await asyncio.to_thread(lambda: list(islice(self.service.parts.store.select(query), most)))

    # -- commands ----------------------------------------------------------------------------

    async def submit(self, request: Request) -> Response:
        new = await _body(request, NewRun)
        run, findings = await self.service.submit(
            new.workflow,
            new.payload,
            user=_named(new.user, "user"),
            workcell=new.workcell,
            priority=new.priority,
            experiment=new.experiment,
            request=request.headers.get("idempotency-key", ""),
        )
        warnings = [msgspec.to_builtins(finding) for finding in findings]
        return _json({"run": run, "warnings": warnings}, 201)

    async def change(self, request: Request) -> Response:
        verb, run = request.path_params["verb"], request.path_params["run"]
        if verb not in ("cancel", "pause", "resume"):
            raise HTTPException(404, f"A run cannot be asked to {verb!r}.")
        await self.service.change(run, verb, (await _body(request, By)).by)
        return _json({"run": run})

    async def start_experiment(self, request: Request) -> Response:
        new = await _body(request, NewExperiment)
        experiment = await self.service.start_experiment(
            new.name,
            _named(new.user, "user"),
            new.closing,
            new.payload,
            workcell=new.workcell,
            priority=new.priority,
            request=request.headers.get("idempotency-key", ""),
            parking=new.parking,
        )
        return _json({"experiment": experiment}, 201)

    async def end_experiment(self, request: Request) -> Response:
        experiment = request.path_params["experiment"]
        end = await _body(request, End)
        by = request.headers.get("labos-user", "application")
        await self.service.end_experiment(experiment, end.why, by)
        return _json({"experiment": experiment})

    async def note(self, request: Request) -> Response:
        note = await _body(request, Note)
        experiment = request.path_params["experiment"]
        by = request.headers.get("labos-user", "application")
        await self.service.note(experiment, note.kind, note.name, note.facts, by)
        return _json({"experiment": experiment}, 201)

    async def heartbeat(self, request: Request) -> Response:
        self.service.hear(request.path_params["experiment"])
        return _json({})

    async def resolve(self, request: Request) -> Response:
        answer = await _body(request, Answer)
        intervention = request.path_params["intervention"]
        await self.service.resolve(
            intervention, answer.choice, _named(answer.by, "by"), answer.note, answer.result
        )
        return _json({"intervention": intervention, "choice": answer.choice})

    async def emergency_stop(self, request: Request) -> Response:
        stop = await _body(request, Stop)
        return _json(await self.service.emergency_stop(_named(stop.target, "target"), stop.by))

    async def take_out(self, request: Request) -> Response:
        outage = await _body(request, Outage)
        module, by = request.path_params["module"], _named(outage.by, "by")
        await self.service.take_out(module, _named(outage.why, "why"), outage.until, by)
        return _json({"module": module})

    async def put_back(self, request: Request) -> Response:
        module = request.path_params["module"]
        await self.service.put_back(module, (await _body(request, By)).by)
        return _json({"module": module})

    async def place(self, request: Request) -> Response:
        placed = await _body(request, Placed)
        labware = await self.service.place(placed.station, placed.labware, _named(placed.by, "by"))
        return _json({"labware": labware}, 201)

    async def empty(self, request: Request) -> Response:
        emptied = await _body(request, Emptied)
        name = await self.service.empty(emptied.station, _named(emptied.by, "by"))
        return _json({"station": name}, 201)

    async def load(self, request: Request) -> Response:
        told = await _body(request, Load)
        names = await load(self.service, told, _named(told.by, "by"))
        return _json({"labware": names}, 201)

    async def unload(self, request: Request) -> Response:
        told = await _body(request, Unload)
        names, nameless = await unload(self.service, told, _named(told.by, "by"))
        return _json({"labware": names, "nameless": nameless})

    async def replenish(self, request: Request) -> Response:
        told, module = await _body(request, Refill), request.path_params["module"]
        amount = await replenish(self.service, module, told, _named(told.by, "by"))
        return _json({"module": module, "resource": told.resource, "amount": amount})

    async def declare(self, request: Request) -> Response:
        told = await _body(request, Declared)
        by = _named(told.by, "by")
        found = await declare_bench(self.service, told.stations, told.workcell, by, empty=told.empty)
        return _json({"declared": found}, 201)

    async def apply_workcell(self, request: Request) -> Response:
        told = await _body(request, WorkcellText)
        by = _named(told.by, "by")
        return _json(await apply_workcell(self.service, told.text, told.name, by, dry_run=told.dry_run))

    async def teach(self, request: Request) -> Response:
        told = await _body(request, Taught)
        module, by = self.service.module(request.path_params["module"]), _named(told.by, "by")
        station = self.service.station(told.station)
        command = TeachLocation(module, station, tuple(told.pose), by, told.why)
        if await self.kernel.execute(command, by):
            self.service.parts.follow_workcells([module])  # its node learns poses when it starts
        return _json({"version": self.kernel.state.modules.by_name[module].taught[station].version}, 201)

    async def locations(self, request: Request) -> Response:
        """The poses of a module as they are now, by station; version 0 is the workcell file's."""
        module = self.kernel.state.modules.by_name[self.service.module(request.path_params["module"])]
        found = {
            name: {"pose": pose, "version": 0, "proven": True}
            for name, pose in module.spec.config.get("poses", {}).items()
        }
        for station, taught in module.taught.items():
            found[local(station)] = msgspec.to_builtins(taught)
        return _json({"locations": found})

    async def enter(self, request: Request) -> Response:
        asked = await _body(request, Entering)
        cell, by = request.path_params["workcell"], _named(asked.by, "by")
        runs = await request_access(self.service, cell, by, asked.why, park=asked.park)
        return _json({"workcell": cell, "parking": runs}, 201)

    async def leave(self, request: Request) -> Response:
        told = await _body(request, Leaving)
        cell, by = request.path_params["workcell"], _named(told.by, "by")
        await end_access(self.service, cell, by, told.note, told.changed)
        return _json({"workcell": cell})

    async def barcode(self, request: Request) -> Response:
        told = await _body(request, Barcode)
        labware = LabwareId(request.path_params["labware"])
        by = _named(told.by, "by")
        await self.kernel.execute(NameBarcode(labware, told.barcode, by, told.replace), by)
        return _json({"labware": labware}, 201)

    async def observe(self, request: Request) -> Response:
        seen = await _body(request, Seen)
        return _json(await observe(self.service, seen.station, seen.what, _named(seen.by, "by")), 201)

    async def give(self, request: Request) -> Response:
        given = await _body(request, Given)
        labware, by = request.path_params["labware"], _named(given.by, "by")
        await give(self.service, labware, given.to, by, force=given.force, note=given.note)
        return _json({"labware": labware, "owner": given.to}, 201)

    async def samples(self, request: Request) -> Response:
        sheet = await _body(request, Sheet)
        plates = await register_samples(
            self.service,
            sheet.text,
            sheet.name,
            _named(sheet.by, "by"),
            labware=sheet.labware,
            station=sheet.station,
            replace=sheet.replace,
        )
        return _json({"plates": plates}, 201)


# -- in and out --------------------------------------------------------------------------------


async def _body(request: Request, kind: type[T]) -> T:
    """The request's JSON. Raises BadInput."""
    if int(request.headers.get("content-length") or 0) > MAX_BODY:
        raise BadInput(f"The request is larger than {MAX_BODY // 1024 // 1024} MB.")
    raw = await request.body()
    try:
        return msgspec.json.decode(raw or b"{}", type=kind)
    except msgspec.MsgspecError as error:
        raise BadInput(f"The request cannot be read: {error}.", remedy="Send the JSON of the docs.") from None


def _named(value: str, field: str) -> str:
    if not value.strip():
        raise BadInput(f"The field {field!r} is empty.", remedy="Say who asks.")
    return value


def _number(request: Request, name: str, default: int) -> int:
    try:
        return max(int(request.query_params.get(name, default)), 0)
    except ValueError:
        raise BadInput(f"{name!r} must be a whole number.") from None


def _seconds(request: Request, name: str) -> float:
    try:
        return max(float(request.query_params.get(name, 0.0)), 0.0)
    except ValueError:
        raise BadInput(f"{name!r} must be a number of seconds.") from None


def _story(story: msgspec.Struct) -> Any:
    data = msgspec.to_builtins(story)
    data.pop("flying", None)
    return data


def _event(record: Record) -> dict[str, Any]:
    head = record.head
    return {
        "position": head.position,
        "time": iso_time(head.recorded_at),
        "recorded_at": head.recorded_at,
        "type": head.type,
        "schema": head.schema,
        "version": head.version,
        "stream": head.stream,
        "actor": head.actor,
        "correlation": head.correlation,
        "causation": head.causation,
        "id": head.id,
        "payload": msgspec.Raw(record.payload),
    }


def _json(value: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(value), status, media_type="application/json")


async def _labos_error(request: Request, error: LabosError) -> Response:
    return _json(body_of(error), status_of(error))


async def _http_error(request: Request, error: HTTPException) -> Response:
    return _json({"error": error.detail, "remedy": "", "code": "http", "details": []}, error.status_code)


async def _surprise(request: Request, error: Exception) -> Response:
    _log.error("request_failed", path=request.url.path, error=repr(error))
    text = f"LabOS failed on this request ({type(error).__name__})."
    remedy = "This is a fault of LabOS; its log tells more."
    return _json({"error": text, "remedy": remedy, "code": "internal", "details": []}, 500)
