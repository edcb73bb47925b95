"""The HTTP server in the kernel's event loop."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator

import uvicorn

from labos.errors import BadInput
from labos.http.app import create_app
from labos.http.service import LabService


class _Server(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals belong to whoever runs the lab."""
        yield


class HttpServer:
    """Serves a lab on one address; loopback only unless told otherwise."""

    def __init__(self, service: LabService, host: str, port: int) -> None:
        self._service = service
        self._socket = _listen(host, port)
        bound = self._socket.getsockname()
        self.url = f"http://{host}:{bound[1]}"
        self.port = int(bound[1])
        config = uvicorn.Config(
            create_app(service),
            log_config=None,
            access_log=False,
            lifespan="off",
            timeout_graceful_shutdown=1,
            ws="none",
        )
        self._server = _Server(config)
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """The socket listens already: requests that come before the server is up wait for it."""
        self._task = asyncio.get_running_loop().create_task(self._server.serve([self._socket]))

    async def close(self) -> None:
        self._service.feed.close()
        self._server.should_exit = True
        if self._task is not None:
            await asyncio.wait({self._task}, timeout=5.0)
        self._socket.close()


def _listen(host: str, port: int) -> socket.socket:
    listening = socket.socket()
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise BadInput(
            f"The address {host}:{port} for HTTP cannot be used: {error.strerror or error}.",
            remedy="Stop the other process, or choose another port with --http-port.",
        ) from None
    listening.listen(128)
    return listening
