"""An operation of the API, declared once: its route, the checks of its requests and its description are
derived from it.

The parameters of a handler show what it reads: ``path``, ``query`` and ``body`` are structs, and its return
value is a struct too. An operation decorates its handler; ``read``, ``change`` and ``submit`` are
operations whose values are given in part::

    @change(route="POST /runs/{run}/cancel", summary="Cancel a run", needs="submitter", …)
    async def cancel_run(call: Call, path: OfRun, body: RunCancel) -> RunChanged: ...
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Awaitable, Callable, Mapping
from functools import cached_property, partial
from typing import Any, Literal

import msgspec
from starlette.requests import Request
from starlette.responses import Response

from labos.core.ids import CampaignId
from labos.core.registry import Event
from labos.core.viewer import Viewer
from labos.core.visibility import find_hidden, find_viewer
from labos.errors import Forbidden, NotFound, NotSignedIn
from labos.http import wire
from labos.http.ends import StreamEnds
from labos.http.idempotency import IdempotentAnswers, LoggedRequest, mark_of
from labos.http.identity import Gate, Who
from labos.http.limits import LARGEST_BODY, SMALL_BODY
from labos.http.notes import notes_of
from labos.http.recorded import answer_from_log
from labos.http.repeats import make_digest_of_request
from labos.http.service import LabService
from labos.http.shared import Shared
from labos.http.views import make_lab_view
from labos.services.accounts import Need

JSON = "application/json"

ADMITTED = "labos.admitted"
"""The key in a request's scope with the user, if an API process has admitted the request."""


MOST_VIEWERS = 100
"""At most so many different views of the lab's state are kept, for users who see different campaigns."""


class Api:
    """The objects that the operations of one lab share."""

    def __init__(self, service: LabService, gate: Gate) -> None:
        self.service, self.gate = service, gate
        self.kernel = service.kernel
        viewers = service.viewers
        self.ends = StreamEnds(self.kernel.clock, viewers.cut if viewers is not None else lambda key: None)
        gate.accounts.on_end.append(self.ends.cut_all)
        self.arriving = wire.BodyReader()
        self.idempotent = IdempotentAnswers()
        self._states: dict[tuple[bool, Viewer | None], Shared] = {}

    def state_for(self, viewer: Viewer | None, *, waits: bool) -> Shared:
        """The state of the lab, shared by all users who see the same campaigns."""
        if viewer is not None and not self.kernel.state.campaigns.restricted:
            viewer = None
        if (waits, viewer) not in self._states and len(self._states) >= MOST_VIEWERS:
            del self._states[next(iter(self._states))]
        work = partial(self._make_view, waits=waits, viewer=viewer)
        return self._states.setdefault((waits, viewer), Shared(work, self.kernel.flush))

    def _make_view(self, *, waits: bool, viewer: Viewer | None) -> bytes:
        link, hidden = self.service.link, find_hidden(self.kernel.state, viewer)
        notes = link.notes if link is not None else notes_of(self.service)
        return msgspec.json.encode(make_lab_view(self.kernel, notes, waits=waits, hidden=hidden))


class Call:
    """A request to an operation: everything besides its path, query and body."""

    def __init__(self, api: Api, request: Request, who: Who, service: LabService | None = None) -> None:
        self.api, self.request, self.who = api, request, who
        self.service = service if service is not None else api.service
        self.kernel = self.service.kernel

    @property
    def user(self) -> str:
        """The requesting user: the signed-in user; in a lab without users, the user in the header LabOS-User.
        Raises BadInput."""
        return self.who.actor if self.who.is_known else wire.read_asker(self.request)

    @cached_property
    def viewer(self) -> Viewer | None:
        """Which campaigns the requesting user sees; None: all."""
        return find_viewer(self.kernel.state, self.who.actor) if self.who.is_known else None

    @cached_property
    def hidden(self) -> frozenset[CampaignId]:
        """The campaigns that the requesting user does not see."""
        return find_hidden(self.kernel.state, self.viewer)

    def expect_seen(self, campaign: str) -> None:
        """Raises NotFound for a campaign that the user does not see, as for a campaign that does not
        exist."""
        if campaign in self.hidden:
            raise NotFound(f"There is no campaign {campaign!r}.", remedy="List them: labos campaign list")

    def expect_run_seen(self, run: str) -> None:
        """Raises NotFound for a run that has not ended, of a campaign that the user does not see."""
        known = self.kernel.state.runs.get(run)
        if known is not None and known.campaign in self.hidden:
            raise NotFound(f"There is no run {run!r}.", remedy="List them: labos runs")

    @property
    def address(self) -> str:
        """The address of the client; empty if it is not known."""
        return self.request.client.host if self.request.client is not None else ""

    @property
    def is_sent_on(self) -> bool:
        """Whether an API process has already handled the request, and sent it on to the kernel."""
        return ADMITTED in self.request.scope

    @property
    def key(self) -> str:
        """The idempotency key; empty if there is none. Raises BadInput."""
        return wire.read_key(self.request)


class AdmittedRequest(msgspec.Struct, frozen=True):
    """A request that was admitted and read: ``key`` is its idempotency key (empty: none that is used),
    ``digest`` is a digest of the whole request."""

    request: Request
    who: Who
    arguments: dict[str, msgspec.Struct]
    key: str
    digest: str


class Shape(msgspec.Struct, frozen=True, dict=True):
    """The structs that a handler reads and returns."""

    path: type[msgspec.Struct] | None
    query: type[msgspec.Struct] | None
    body: type[msgspec.Struct] | None
    answer: Any

    @cached_property
    def lists(self) -> frozenset[str]:
        """The parameters of the query that may be repeated."""
        fields = msgspec.structs.fields(self.query) if self.query is not None else ()
        return frozenset(f.encode_name for f in fields if isinstance(f.default_factory, type))


class Method(msgspec.Struct, frozen=True):
    """How a method of ``LabClient`` calls an operation: the client is generated from this and from the types
    of the operation.

    ``name`` begins with an underscore if a hand-written method passes its options on to the generated one;
    ``by_hand``: there is only the hand-written one.

    ``positional`` are the first parameters, in order, as ``module, by='somebody', until_ns=until``: a value
    in quotation marks is a default, another one the name that the parameter has in the request. If it is
    empty, they are the names in the path, the required fields of the body, and the requesting user. All other
    parameters are keywords.

    ``take`` is the member of the answer that is returned (none: nothing is returned). With ``repeat`` the
    request may be carried out twice; with a ``key`` it is carried out once, however often it is sent.
    ``fixed`` members of the request are always the same, those ``without`` are never sent. ``timeout_s`` goes
    before the client's own.
    """

    name: str
    positional: str = ""
    take: str | None = ""
    repeat: bool = False
    key: Literal["", "new", "given"] = ""
    fixed: Mapping[str, Any] = {}
    without: tuple[str, ...] = ()
    timeout_s: float | None = None
    by_hand: bool = False


class Operation(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """``route`` is the method and the path: ``GET /runs/{run}``. ``client`` describes the client's method.
    ``tag`` is the heading in the description. ``problems`` are the codes of its own problems, besides those
    of every request; ``example`` is a body, ``example_answer`` an answer. ``answer`` is for handlers that
    return a whole ``Response``; ``media`` are its content types. ``headers`` are the headers that it reads.
    ``logs_key``: the log contains the idempotency key, so that a repetition is recognised after a restart
    too. ``needs`` is the lowest role that the user must have, ``nobody`` for requests before signing in.
    ``by_home``: the owner of the lab's folder may send it; ``by_link``: a token of scope viewer may be in the
    address. ``secret``: the answer is not kept for a repetition. ``at_kernel``: only the kernel's process can
    answer. ``recall`` computes the answer from the events of a request, if the handler cannot be called
    again."""

    route: str
    client: Method
    summary: str
    needs: Need | Literal["nobody"]
    handler: Any = None
    tag: str = ""
    by_home: bool = False
    by_link: bool = False
    secret: bool = False
    at_kernel: bool = False
    status: int = 200
    other_statuses: Mapping[int, str] = {}
    problems: tuple[str, ...] = ()
    example: Mapping[str, Any] | None = None
    example_answer: Any = None
    answer: Any = None
    media: tuple[str, ...] = (JSON,)
    headers: tuple[str, ...] = ()
    largest_body: int = SMALL_BODY
    logs_key: bool = False
    recall: Callable[[list[Event]], Any] | None = None

    def __call__(self, handler: Callable[..., Any]) -> Operation:
        return msgspec.structs.replace(self, handler=handler)

    async def call(self, call: Call, arguments: Mapping[str, msgspec.Struct]) -> Response:
        """The response of the handler. A handler that is not ``async`` only reads the state; its answer is
        sent when everything that it has read is on disk."""
        found = self.handler(call, **arguments)
        if inspect.isawaitable(found):
            found = await found
        else:
            await call.kernel.flush()
        return respond(self, found)

    @property
    def id(self) -> str:
        return str(self.handler.__name__)

    @property
    def method(self) -> str:
        """GET or POST."""
        return self.route.partition(" ")[0]

    @property
    def path(self) -> str:
        return self.route.partition(" ")[2]

    @cached_property
    def shape(self) -> Shape:
        hints = typing.get_type_hints(self.handler)
        answer = self.answer if self.answer is not None else hints.get("return")
        return Shape(hints.get("path"), hints.get("query"), hints.get("body"), answer)

    def endpoint(self, api: Api) -> Callable[[Request], Awaitable[Response]]:
        """The endpoint for Starlette: it reads the request, calls the handler, and sends its answer."""

        link = api.service.link

        async def serve(request: Request) -> Response:
            if link is not None:
                await link.up_to_date(wire.read_position(request))
            who = await self._admit(api, request)
            arguments = await self._read(api, request, who)

            async def work() -> Response:
                return await self.call(Call(api, request, who), arguments)

            key = wire.read_key(request) if self.method == "POST" and not self.secret else ""
            if getattr(arguments.get("body"), "dry_run", False):
                key = ""  # a check changes nothing
            digest = ""
            path = request.url.path
            if key:
                digest = make_digest_of_request(
                    path, who.user or wire.read_header(request, "labos-user"), arguments
                )
            asked, logged = AdmittedRequest(request, who, arguments, key, digest), None
            if key and not self.logs_key and api.service.marks is not None:
                again = partial(answer_from_log, api, self, asked)
                mark = mark_of(who.user, path, key)
                logged = LoggedRequest(api.service.marks, mark, key, digest, again)
            if link is not None:
                found = await link.answer(self, asked, logged, work)
            elif key:
                found = await api.idempotent.answer_once(
                    key, path, digest, work, user=who.user, logs_key=self.logs_key, logged=logged
                )
            else:
                found = await work()
            found.headers.setdefault(wire.POSITION, str(api.kernel.durable))
            return found

        return serve

    async def _admit(self, api: Api, request: Request) -> Who:
        if self.needs == "nobody":
            return Who("open")
        admitted = request.scope.get(ADMITTED)
        if admitted is not None:
            api.gate.confirm(admitted, self.needs)
            return typing.cast(Who, admitted)
        try:
            return await api.gate.admit(request, self.needs, by_home=self.by_home, by_link=self.by_link)
        except (NotSignedIn, Forbidden):
            request.scope[wire.UNREAD] = True
            await wire.drain(request.stream())
            raise

    async def _read(self, api: Api, request: Request, who: Who) -> dict[str, msgspec.Struct]:
        shape, arguments = self.shape, {}
        if shape.path is not None:
            arguments["path"] = wire.read_path(request, shape.path)
        query = wire.read_query(request, shape.query, shape.lists)
        if query is not None:
            arguments["query"] = query
        if shape.body is not None:
            asker = who.actor if who.is_known else ""
            arguments["body"] = await wire.read_body(
                request, api.arriving, shape.body, self.largest_body, asker
            )
        return arguments


read = partial(Operation, needs="viewer")
"""An operation that changes nothing."""

change = partial(Operation, needs="submitter", problems=("refused",))
"""An operation with a command that the rules may forbid in the present state."""

operate = partial(change, needs="operator")
"""A change by a person who works at the modules and the bench."""

administer = partial(change, needs="admin")
"""A change by a person who looks after the lab."""

apply_file = partial(administer, problems=("refused", "spec_error", "spec_errors"))
"""A change by a file for the whole lab."""

submit = partial(
    Operation,
    needs="submitter",
    problems=("not_found", "refused", "spec_error", "spec_errors"),
    largest_body=LARGEST_BODY,
)
"""An operation that reads files of a user, to plan or to submit."""


def respond(operation: Operation, found: Any) -> Response:
    """The response for the return value of a handler."""
    return found if isinstance(found, Response) else wire.answer(found, operation.status)
