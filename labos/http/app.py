"""The routes. Every answer is given when what it tells is on disk."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from itertools import islice

import msgspec
import structlog
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from labos.core.decide.labware import NameBarcode
from labos.core.envelope import Record
from labos.core.ids import LabwareId
from labos.errors import BadInput, LabosError
from labos.http import wire
from labos.http.access import end_access, request_access
from labos.http.arriving import Arriving
from labos.http.asking import ask_nodes, switch_trace
from labos.http.bodies import (
    Answer,
    Barcode,
    By,
    Change,
    Declared,
    End,
    Entering,
    Given,
    Leaving,
    NewExperiment,
    NewRun,
    Note,
    Outage,
    Placed,
    Seen,
    Sheet,
    Stop,
    Taught,
    Trace,
    WorkcellText,
)
from labos.http.control import VERBS, Control, control
from labos.http.declare import declare_bench
from labos.http.door import Door
from labos.http.files import send_file
from labos.http.limits import LARGEST_BODY, check_person, name_in_emergency
from labos.http.round import RoundWords, round_view, say
from labos.http.samples import register_samples
from labos.http.service import LabService
from labos.http.shared import Shared
from labos.http.sight import give, observe
from labos.http.stock import Load, Refill, Unload, load, replenish, unload
from labos.http.tail import PAGE
from labos.http.teaching import locations, teach
from labos.http.views import lab_view
from labos.http.workcells import apply_workcell
from labos.ports import LogQuery
from labos.services.inventory import inventory
from labos.services.times import iso_time, with_iso_times

LONGEST_WAIT_S = 60.0
CONNECTION = "labos.connection"
"""Where a request's scope has its connection."""

_log = structlog.get_logger(__name__)


def create_app(service: LabService, host: str = "localhost") -> Starlette:
    """The application over one lab, for requests to ``host``."""
    api = _Api(service)

    def route(path: str, handler: Callable[[Request], Awaitable[Response]], method: str = "GET") -> Route:
        return Route(path, wire.checked(handler), methods=[method])

    app = Starlette(
        routes=[
            route("/health", api.health),
            route("/state", api.state),
            route("/events", api.events),
            route("/inventory", api.inventory),
            route("/nodes", api.nodes),
            route("/files/{sha256}", api.file),
            route("/runs", api.runs),
            route("/runs", api.submit, "POST"),
            route("/runs/{run}", api.run),
            route("/runs/{run}/{verb:str}", api.change, "POST"),
            route("/experiments", api.start_experiment, "POST"),
            route("/experiments/{experiment}/end", api.end_experiment, "POST"),
            route("/experiments/{experiment}/notes", api.note, "POST"),
            route("/experiments/{experiment}/heartbeat", api.heartbeat, "POST"),
            route("/interventions/{intervention}", api.resolve, "POST"),
            route("/control/{verb}", api.control, "POST"),
            route("/estop", api.emergency_stop, "POST"),
            route("/nodes/{module:path}/out-of-service", api.take_out, "POST"),
            route("/nodes/{module:path}/in-service", api.put_back, "POST"),
            route("/nodes/{module:path}/trace", api.trace, "POST"),
            route("/stations/place", api.place, "POST"),
            route("/stations/load", api.load, "POST"),
            route("/stations/unload", api.unload, "POST"),
            route("/nodes/{module:path}/replenish", api.replenish, "POST"),
            route("/stations/observe", api.observe, "POST"),
            route("/stations/declare", api.declare, "POST"),
            route("/round", api.round),
            route("/round", api.say, "POST"),
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
            LabosError: wire.labos_error,  # type: ignore[dict-item]
            HTTPException: wire.http_error,  # type: ignore[dict-item]
            Exception: wire.surprise,
        },
        middleware=[Middleware(Door, host=host)],
    )
    app.state.arriving = Arriving()
    return app


class _Api:
    def __init__(self, service: LabService) -> None:
        self.service = service
        self.kernel = service.kernel
        self.feed = service.feed
        self._shown = Shared(partial(self._view, waits=True), self._written)
        self._shown_without_waits = Shared(partial(self._view, waits=False), self._written)

    # -- questions ---------------------------------------------------------------------------

    async def health(self, request: Request) -> Response:
        kernel = self.kernel
        state = kernel.state
        return wire.answer(
            {
                "status": "failed" if kernel.failed.done() else "ok",
                "lab": state.lab.id,
                "name": state.lab.name,
                "epoch": state.lab.epoch,
                "position": kernel.durable,
                "suspended": kernel.suspended,
                "simulated": self.service.parts.simulated,
                "pace": state.lab.pace,
                "broken_drivers": dict(self.service.parts.broken_drivers),
                "log_check": check.view() if (check := self.service.parts.log_check) is not None else None,
            }
        )

    async def state(self, request: Request) -> Response:
        shown = self._shown if request.query_params.get("waits", "1") != "0" else self._shown_without_waits
        return wire.encoded(await shown.get())

    async def _written(self) -> None:
        await self.kernel.written()

    def _view(self, *, waits: bool) -> bytes:
        parts = self.service.parts
        view = lab_view(
            self.kernel,
            simulated=parts.simulated,
            rejected={str(name): why for name, why in parts.registry.rejected.items()},
            supervised=parts.supervised.nodes if parts.supervised is not None else {},
            waits=waits,
        )
        return msgspec.json.encode(view)

    async def inventory(self, request: Request) -> Response:
        now = self.kernel.clock.now_ns()
        found = with_iso_times(msgspec.to_builtins(inventory(self.kernel.state, now, iso_time(now)[:10])))
        await self.kernel.written()
        return wire.answer(found)

    async def file(self, request: Request) -> Response:
        return await send_file(request, self.service.parts.blobs)

    async def nodes(self, request: Request) -> Response:
        """What the nodes of modules answer now; ``module`` may be repeated, without it all are asked. With
        ``check=1`` each also says who it is and what its device sees."""
        check = request.query_params.get("check", "0") != "0"
        heard = await ask_nodes(self.service, request.query_params.getlist("module"), check=check)
        await self.kernel.written()
        return wire.answer({"modules": msgspec.to_builtins(heard)})

    async def runs(self, request: Request) -> Response:
        """Runs that are alive; with ``ended=N``, the last N that have ended too."""
        state = self.kernel.state
        alive = [*state.runs.active, *state.runs.queued]
        await self.kernel.written()
        ended = wire.number(request, "ended", PAGE)
        over: list[str] = []
        if ended:
            query = LogQuery(types=("run.completed", "run.failed", "run.cancelled"), last=ended)
            over = [record.head.stream for record in await self._read(query, ended)]
        stories = [await self.service.story(run) for run in [*over, *alive]]
        return wire.answer({"runs": [wire.story_of(story) for story in stories]})

    async def run(self, request: Request) -> Response:
        wait_s = min(wire.seconds(request, "wait"), LONGEST_WAIT_S)
        return wire.answer(wire.story_of(await self.service.story(request.path_params["run"], wait_s)))

    async def events(self, request: Request) -> Response:
        """Committed events in order: one page, or a stream of server-sent events (``follow=1``).
        Filters: after, type (may be repeated), stream, correlation, actor, mentions, last."""
        params = request.query_params
        query = LogQuery(
            after=wire.number(request, "after"),
            types=tuple(params.getlist("type")),
            streams=tuple(params.getlist("stream")),
            correlation=params.get("correlation", ""),
            actor=params.get("actor", ""),
            mentions=params.get("mentions", ""),
            last=wire.number(request, "last", PAGE) or None,
        )
        if params.get("follow", "0") in ("1", "true"):
            known = wire.header(request, "last-event-id")
            if known.isdecimal() and len(known) < 19:
                query = msgspec.structs.replace(query, after=max(int(known), query.after), last=None)
            if await self._hand_over(request, query):
                return Response()  # nobody hears it: the connection is somebody else's now
            return StreamingResponse(self.service.tail.follow(query), media_type="text/event-stream")
        wait_s = min(wire.seconds(request, "wait"), LONGEST_WAIT_S)
        if wait_s and self.kernel.durable <= query.after:
            await self.feed.until(lambda: self.kernel.durable > query.after, wait_s, each_s=0.01)
        return wire.encoded(await self.service.tail.page(query))

    async def _hand_over(self, request: Request, query: LogQuery) -> bool:
        """Whether the process for followers has taken the connection."""
        viewers, connection = self.service.viewers, request.scope.get(CONNECTION)
        if viewers is None or connection is None:
            return False
        return bool(await connection.give_away(lambda s: viewers.take_over(s, query, self.kernel.durable)))

    async def _read(self, query: LogQuery, most: int) -> list[Record]:
        return await asyncio.to_thread(lambda: list(islice(self.service.parts.store.select(query), most)))

    # -- commands ----------------------------------------------------------------------------

    async def submit(self, request: Request) -> Response:
        new = await wire.body(request, NewRun, LARGEST_BODY)
        run, findings = await self.service.submit(
            new.workflow,
            new.payload,
            user=new.user,
            workcell=new.workcell,
            priority=new.priority,
            experiment=new.experiment,
            place=new.place,
            request=wire.key_of(request),
        )
        warnings = [msgspec.to_builtins(finding) for finding in findings]
        return wire.answer({"run": run, "warnings": warnings}, 201)

    async def change(self, request: Request) -> Response:
        verb, run = request.path_params["verb"], request.path_params["run"]
        if verb not in ("cancel", "pause", "resume"):
            raise HTTPException(404, f"A run cannot be asked to {verb!r}.")
        change = await wire.body(request, Change)
        await self.service.change(run, verb, change.by, stay=change.stay, why=change.why)
        return wire.answer({"run": run})

    async def start_experiment(self, request: Request) -> Response:
        new = await wire.body(request, NewExperiment, LARGEST_BODY)
        experiment = await self.service.start_experiment(
            new.name,
            new.user,
            new.closing,
            new.payload,
            workcell=new.workcell,
            priority=new.priority,
            request=wire.key_of(request),
            parking=new.parking,
        )
        return wire.answer({"experiment": experiment}, 201)

    async def end_experiment(self, request: Request) -> Response:
        experiment = request.path_params["experiment"]
        end = await wire.body(request, End)
        by = wire.asker(request)
        await self.service.end_experiment(experiment, end.why, by)
        return wire.answer({"experiment": experiment})

    async def note(self, request: Request) -> Response:
        note = await wire.body(request, Note)
        experiment = request.path_params["experiment"]
        by = wire.asker(request)
        await self.service.note(experiment, note.kind, note.name, note.facts, by)
        return wire.answer({"experiment": experiment}, 201)

    async def heartbeat(self, request: Request) -> Response:
        self.service.hear(request.path_params["experiment"])
        return wire.answer({})

    async def resolve(self, request: Request) -> Response:
        answer = await wire.body(request, Answer)
        intervention = request.path_params["intervention"]
        await self.service.resolve(intervention, answer.choice, answer.by, answer.note, answer.result)
        return wire.answer({"intervention": intervention, "choice": answer.choice})

    async def control(self, request: Request) -> Response:
        verb = request.path_params["verb"]
        if verb not in VERBS:
            raise HTTPException(404, f"Nothing can be asked to {verb!r}; only to {', '.join(VERBS)}.")
        return wire.answer(await control(self.service.kernel, verb, await wire.body(request, Control)))

    async def emergency_stop(self, request: Request) -> Response:
        stop = await wire.body(request, Stop)
        return wire.answer(await self.service.emergency_stop(stop.target, name_in_emergency(stop.said_by)))

    async def take_out(self, request: Request) -> Response:
        outage = await wire.body(request, Outage)
        module, by = request.path_params["module"], outage.by
        await self.service.take_out(module, _said(outage.why, "why"), outage.until, by)
        return wire.answer({"module": module})

    async def put_back(self, request: Request) -> Response:
        module = request.path_params["module"]
        await self.service.put_back(module, (await wire.body(request, By)).by)
        return wire.answer({"module": module})

    async def trace(self, request: Request) -> Response:
        """A running node writes down every byte on its device's wires, or no more."""
        wanted = await wire.body(request, Trace)
        module = self.service.module(request.path_params["module"])
        return wire.answer({"module": module, "file": await switch_trace(self.service, module, wanted.on)})

    async def place(self, request: Request) -> Response:
        placed = await wire.body(request, Placed)
        labware = await self.service.place(placed.station, placed.labware, placed.by)
        return wire.answer({"labware": labware}, 201)

    async def load(self, request: Request) -> Response:
        told = await wire.body(request, Load)
        names = await load(self.service, told, told.by)
        return wire.answer({"labware": names}, 201)

    async def unload(self, request: Request) -> Response:
        told = await wire.body(request, Unload)
        names, nameless = await unload(self.service, told, told.by)
        return wire.answer({"labware": names, "nameless": nameless})

    async def replenish(self, request: Request) -> Response:
        told, module = await wire.body(request, Refill), request.path_params["module"]
        amount = await replenish(self.service, module, told, told.by)
        return wire.answer({"module": module, "resource": told.resource, "amount": amount})

    async def declare(self, request: Request) -> Response:
        told = await wire.body(request, Declared)
        by = told.by
        found = await declare_bench(self.service, told.stations, told.workcell, by, empty=told.empty)
        return wire.answer({"declared": found}, 201)

    async def round(self, request: Request) -> Response:
        view = round_view(self.kernel.state)
        await self.kernel.written()
        return wire.answer(view)

    async def say(self, request: Request) -> Response:
        words = await wire.body(request, RoundWords)
        return wire.answer(await say(self.service, words, words.by), 201)

    async def apply_workcell(self, request: Request) -> Response:
        told = await wire.body(request, WorkcellText, LARGEST_BODY)
        by = told.by
        return wire.answer(await apply_workcell(self.service, told, by))

    async def teach(self, request: Request) -> Response:
        told = await wire.body(request, Taught)
        by = told.by
        version = await teach(self.service, request.path_params["module"], told, by)
        return wire.answer({"version": version}, 201)

    async def locations(self, request: Request) -> Response:
        name = self.service.module(request.path_params["module"])
        return wire.answer({"locations": locations(self.kernel.state.modules.by_name[name])})

    async def enter(self, request: Request) -> Response:
        asked = await wire.body(request, Entering)
        cell, by = request.path_params["workcell"], asked.by
        runs = await request_access(self.service, cell, by, asked.why, park=asked.park)
        return wire.answer({"workcell": cell, "parking": runs}, 201)

    async def leave(self, request: Request) -> Response:
        told = await wire.body(request, Leaving)
        cell, by = request.path_params["workcell"], told.by
        await end_access(self.service, cell, by, told.note, told.changed)
        return wire.answer({"workcell": cell})

    async def barcode(self, request: Request) -> Response:
        told = await wire.body(request, Barcode)
        labware = LabwareId(request.path_params["labware"])
        by = told.by
        await self.kernel.execute(NameBarcode(labware, told.barcode, by, told.replace), by)
        return wire.answer({"labware": labware}, 201)

    async def observe(self, request: Request) -> Response:
        seen = await wire.body(request, Seen)
        return wire.answer(await observe(self.service, seen.station, seen.what, seen.by), 201)

    async def give(self, request: Request) -> Response:
        given = await wire.body(request, Given)
        labware, by = request.path_params["labware"], given.by
        if given.to.startswith("user:"):
            check_person(given.to.removeprefix("user:"), "to")
        await give(self.service, labware, given.to, by, force=given.force, note=given.note)
        return wire.answer({"labware": labware, "owner": given.to}, 201)

    async def samples(self, request: Request) -> Response:
        sheet = await wire.body(request, Sheet, LARGEST_BODY)
        plates = await register_samples(
            self.service,
            sheet.text,
            sheet.name,
            sheet.by,
            labware=sheet.labware,
            station=sheet.station,
            replace=sheet.replace,
        )
        return wire.answer({"plates": plates}, 201)


def _said(text: str, field: str) -> str:
    """Raises BadInput for nothing but spaces."""
    if not text.strip():
        raise BadInput(f"The field {field!r} is empty.", remedy="Say why.")
    return text
