"""API processes: in a thread of the test's own process, and as ``labos api``."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from pathlib import Path

import httpx

from labos.bootstrap import ApiSettings, open_api
from labos.bootstrap._api import ApiRuntime
from labos.client._lab import API
from tests.support.lab_process import PATIENCE_S, until


class ApiThread:
    """What ``labos api`` runs, in a thread with an event loop of its own."""

    def __init__(self, settings: ApiSettings) -> None:
        self._settings = settings
        self._opened = threading.Event()
        self._error: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self.runtime: ApiRuntime
        self._thread = threading.Thread(target=self._main, daemon=True)

    @property
    def url(self) -> str:
        return self.runtime.http.url

    def client(self, token: str = "", **headers: str) -> httpx.Client:
        shown = {"authorization": f"Bearer {token}"} if token else {}
        return httpx.Client(base_url=self.url + API, timeout=90, headers={**shown, **headers})

    def __enter__(self) -> ApiThread:
        self._thread.start()
        self._opened.wait(PATIENCE_S)
        if self._error is not None:
            raise self._error
        return self

    def __exit__(self, *error: object) -> None:
        assert self._loop is not None
        assert self._end is not None
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def _main(self) -> None:
        try:
            asyncio.run(self._run())
        except BaseException as error:
            self._error = error
        finally:
            self._opened.set()

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        async with open_api(self._settings) as self.runtime:
            self._opened.set()
            await self._end.wait()


class ApiProcess:
    """``labos api`` in a process of its own, on a port of its own."""

    def __init__(self, folder: Path, name: str, port: int, *options: str) -> None:
        self.url = f"http://127.0.0.1:{port}"
        self.log = folder / f"{name}.log"
        self._argv = [
            sys.executable,
            "-m",
            "labos",
            "api",
            "--process",
            name,
            "--http-port",
            str(port),
            *options,
        ]
        self.process: subprocess.Popen[bytes] | None = None
        self.environment: dict[str, str] = {}

    def start(self) -> ApiProcess:
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                self._argv,
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **self.environment},
            )
        until(lambda: self._answers() or self.process.poll() is not None, "the API process answers")  # type: ignore[union-attr]
        assert self.process.poll() is None, self.log.read_text()
        return self

    def _answers(self) -> bool:
        try:
            return httpx.get(f"{self.url}/health").status_code == 200
        except httpx.TransportError:
            return False

    def client(self, token: str = "", **headers: str) -> httpx.Client:
        shown = {"authorization": f"Bearer {token}"} if token else {}
        return httpx.Client(base_url=self.url + API, timeout=90, headers={**shown, **headers})

    def kill(self) -> None:
        """kill -9."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
        if self.process is not None:
            self.process.wait(PATIENCE_S)
