"""``/metrics`` for Prometheus: plain text, beside the JSON interface."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from labos.http import wire
from labos.http.identity import Gate
from labos.http.service import LabService

TEXT = "text/plain; version=0.0.4; charset=utf-8"


def metric_routes(service: LabService, gate: Gate) -> list[Route]:
    """The routes for one lab."""

    async def metrics(request: Request) -> Response:
        """All metrics of the kernel's process."""
        await gate.admit(request, "viewer")
        return PlainTextResponse(service.parts.metrics.text(), media_type=TEXT)

    async def targets(request: Request) -> Response:
        """The addresses at which Prometheus finds the metrics of the kernel and the nodes."""
        await gate.admit(request, "viewer")
        return wire.answer(service.parts.metrics.targets(request.headers.get("host", "")))

    return [
        Route("/metrics", metrics, methods=["GET"]),
        Route("/metrics/targets", targets, methods=["GET"]),
    ]
