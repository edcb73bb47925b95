"""The HTTP application: the operations of the API below ``/api/v1``, and the routes that are not part of it.

An answer is sent only when everything that it reports is on disk.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache

import msgspec
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from labos.errors import LabosError
from labos.http import wire
from labos.http.door import RequestFilter
from labos.http.identity import Gate
from labos.http.openapi import document
from labos.http.operation import Api, Operation
from labos.http.providing import list_provider_routes
from labos.http.routes import OPERATIONS, PREFIX
from labos.http.service import LabService
from labos.http.words import ShownWords

DOCUMENT = f"{PREFIX}/openapi.json"
METRICS = "text/plain; version=0.0.4; charset=utf-8"


def create_app(service: LabService, gate: Gate, names: Collection[str] = ()) -> Starlette:
    """The application for one lab. ``names`` are the host names under which it is reached, besides those of
    this computer."""
    api = Api(service, gate)
    app = Starlette(
        routes=[
            *(_make_route(operation, api) for operation in OPERATIONS),
            *_list_other_routes(api),
            *(list_provider_routes(api, gate.provider) if gate.provider is not None else ()),
        ],
        exception_handlers={
            LabosError: wire.answer_labos_error,  # type: ignore[dict-item]
            HTTPException: wire.answer_http_error,  # type: ignore[dict-item]
            Exception: wire.report_fault,
        },
        middleware=[Middleware(RequestFilter, names=names), Middleware(ShownWords, log=service.parts.store)],
    )
    app.state.api = api
    return app


def _list_other_routes(api: Api) -> list[Route]:
    """Routes for programs that do not know the API: health probes, and collectors of metrics."""

    async def describe(request: Request) -> Response:
        """The description of the API (OpenAPI 3.1)."""
        await api.gate.admit(request, "viewer", by_home=True)
        return wire.answer_encoded(_encode_document())

    async def probe(request: Request) -> Response:
        """Whether this process works: the kernel's process, or an API process. Probes receive no other
        information."""
        failed = api.kernel.failed.done()
        return wire.answer({"status": "failed" if failed else "ok"})

    async def metrics(request: Request) -> Response:
        """All metrics of this process, for Prometheus."""
        await api.gate.admit(request, "viewer")
        return PlainTextResponse(api.service.parts.metrics.text(), media_type=METRICS)

    async def targets(request: Request) -> Response:
        """The addresses at which Prometheus finds the metrics of the kernel and the nodes."""
        await api.gate.admit(request, "viewer")
        return wire.answer(api.service.parts.metrics.targets(request.headers.get("host", "")))

    return [
        Route(DOCUMENT, describe, methods=["GET"]),
        Route("/health", probe, methods=["GET"]),
        Route("/metrics", metrics, methods=["GET"]),
        Route("/metrics/targets", targets, methods=["GET"]),
    ]


def _make_route(operation: Operation, api: Api) -> Route:
    # The name of a module may contain a slash: `rpl/sealer`.
    path = re.sub(r"\{module\}", "{module:path}", operation.path)
    return Route(PREFIX + path, operation.endpoint(api), methods=[operation.method], name=operation.id)


@cache
def _encode_document() -> bytes:
    return msgspec.json.encode(document(OPERATIONS))
