"""The HTTP side of a witness: ``POST /add-checkpoint`` and nothing else (C2SP ``tlog-witness``)."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from labos.clock import SystemClock
from labos.errors import SystemFailed
from labos.http.framing import StrictProtocol
from labos.services.trust.notes import MOST_BYTES
from labos.services.trust.witness import Witness

MOST_CONNECTIONS = 100


def make_witness_app(witness: Witness) -> Starlette:
    async def add_checkpoint(request: Request) -> Response:
        body = b""
        async for piece in request.stream():
            body += piece
            if len(body) > 2 * MOST_BYTES:
                return Response("The request is too large.\n", 413)
        now_s = SystemClock().now_ns() // 10**9
        reply = await asyncio.to_thread(witness.add, body, now_s)
        return Response(reply.text, reply.status, media_type=reply.type)

    return Starlette(routes=[Route("/add-checkpoint", add_checkpoint, methods=["POST"])])


async def serve_witness(witness: Witness, host: str, port: int, ready: Callable[[str], None]) -> None:
    """Serve until cancelled; ``ready`` is called with the URL once connections are accepted. Raises
    SystemFailed for a port in use."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, port))
        except OSError as error:
            raise SystemFailed(
                f"{host}:{port} cannot be used for the server: {error.strerror}.",
                remedy="Name another --port.",
            ) from None
        listening.listen(MOST_CONNECTIONS)
        at = f"[{host}]" if ":" in host else host
        ready(f"http://{at}:{listening.getsockname()[1]}")
        config = uvicorn.Config(
            make_witness_app(witness),
            http=StrictProtocol,
            log_level="warning",
            access_log=False,
            lifespan="off",
            limit_concurrency=MOST_CONNECTIONS,
            timeout_keep_alive=5,
        )
        server = uvicorn.Server(config)
        await server.serve([listening])
