"""The adapter's side of the bridge process: requests and answers over its standard input and output."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import structlog

from labos.adapter._decode import LARGEST_JSON, read_json_text
from labos.adapter._http import NoResponse
from labos.errors import DeviceError

PROGRAM = Path(__file__).with_name("ros_bridge.py")
_log = structlog.get_logger(__name__)
START_S = 30.0
LEAVE_S = 5.0
"""How long the bridge may take to end its ROS node."""
REMEDY = (
    "`ros_python` in `config:` names the Python that has rclpy, or a script that sources ROS and starts it. "
    "From the package index: pip install 'labos-sdl[ros]'"
)


class BridgeProcess:
    """One bridge process. ``python`` is the interpreter with rclpy; ``domain`` is the ROS domain, by default
    that of the environment."""

    def __init__(self, python: str = "", domain: int | None = None) -> None:
        self._python = python or sys.executable
        self._environment = {**os.environ, **({} if domain is None else {"ROS_DOMAIN_ID": str(domain)})}
        self._process: asyncio.subprocess.Process | None = None
        self._reading: asyncio.Task[None] | None = None
        self._listeners: dict[int, Callable[[dict[str, Any] | None], None]] = {}
        self._number = 0

    @property
    def runs(self) -> bool:
        return self._process is not None and self._process.returncode is None

    async def start(self) -> None:
        """Start the process, and wait for its first message. Raises DeviceError."""
        pipe = asyncio.subprocess.PIPE
        try:
            self._process = await asyncio.create_subprocess_exec(
                self._python, str(PROGRAM), stdin=pipe, stdout=pipe, limit=LARGEST_JSON, env=self._environment
            )
        except OSError as error:
            raise DeviceError(
                f"The Python {self._python} of ROS cannot be started ({error.strerror}).",
                effects="none",
                remedy=REMEDY,
            ) from error
        assert self._process.stdout is not None
        try:
            first = await asyncio.wait_for(self._process.stdout.readline(), START_S)
        except TimeoutError:
            first = b""
        if b"ready" not in first:
            await self.close()
            raise DeviceError(
                f"ROS does not start with {self._python}; see the log of its node.",
                effects="none",
                remedy=REMEDY,
            )
        self._reading = asyncio.create_task(self._read(self._process.stdout))

    async def close(self) -> None:
        if self._reading is not None:
            self._reading.cancel()
        process, self._process = self._process, None
        if process is not None and process.stdin is not None:
            process.stdin.close()
            try:
                await asyncio.wait_for(process.wait(), LEAVE_S)
            except TimeoutError:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()

    async def _read(self, lines: asyncio.StreamReader) -> None:
        try:
            while line := await lines.readline():
                try:
                    message = read_json_text(line)
                    known = message.get("id", 0)
                except (ValueError, AttributeError) as error:
                    _log.warning("ros_line_unreadable", line=line[:200], error=str(error))
                    continue
                if receive := self._listeners.get(known):
                    receive(message)
        except ValueError as error:  # a line without an end
            _log.error("ros_line_too_long", error=str(error))
        finally:
            for receive in list(self._listeners.values()):
                receive(None)

    def watch(self, topic: str, kind: str, callback: Callable[[dict[str, Any]], None]) -> None:
        """Report every message of a topic."""

        def receive(message: dict[str, Any] | None) -> None:
            if message is not None and "message" in message:
                callback(message["message"])

        self._say(self._listen(receive), watch=topic, type=kind)

    async def is_offered(self, service: str, kind: str, limit_s: float = 5.0) -> bool:
        """Whether a node offers a service. Raises DeviceError."""
        async with self._ask(ready=service, type=kind) as answers:
            return bool(await asyncio.wait_for(_answer(service, answers), limit_s))

    async def call(self, service: str, kind: str, fields: dict[str, Any], *, wait_s: float) -> Any:
        """Call a service once, and wait for its answer. Raises DeviceError (``none``) if the call was not
        sent within ``wait_s``, Lost if the bridge ended during the wait."""
        async with self._ask(call=service, type=kind, fields=fields, wait_s=wait_s) as answers:
            return await _answer(service, answers)

    async def fetch_frame(self, topic: str, file: Path, limit_s: float) -> dict[str, Any]:
        """Write the next image of a topic to a file as raw bytes; returns its shape. Raises DeviceError."""
        async with self._ask(frame=topic, file=str(file)) as answers:
            try:
                found: dict[str, Any] = await asyncio.wait_for(_answer(topic, answers), limit_s)
            except (TimeoutError, NoResponse) as error:
                raise DeviceError(f"No picture came on {topic}.", effects="none") from error
            return found

    def _listen(self, receive: Callable[[dict[str, Any] | None], None]) -> int:
        self._number += 1
        self._listeners[self._number] = receive
        return self._number

    def _say(self, number: int, **command: Any) -> None:
        process = self._process
        if process is None or process.stdin is None or not self.runs:
            raise DeviceError("The bridge to ROS has ended.", effects="none")
        process.stdin.write(json.dumps({"id": number, **command}).encode() + b"\n")

    @asynccontextmanager
    async def _ask(self, **command: Any) -> AsyncIterator[asyncio.Queue[dict[str, Any] | None]]:
        answers: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        number = self._listen(answers.put_nowait)
        try:
            self._say(number, **command)
            yield answers
        finally:
            del self._listeners[number]
            if "frame" in command:
                with contextlib.suppress(DeviceError):
                    self._say(0, forget=number)


async def _answer(name: str, answers: asyncio.Queue[dict[str, Any] | None]) -> Any:
    sent = False
    while True:
        message = await answers.get()
        if message is None:
            raise NoResponse(f"the bridge to ROS ended before {name} had answered")
        if "sent" in message:
            sent = True
        elif "absent" in message:
            raise DeviceError(f"No node offers {name} in ROS.", effects="none", remedy="Is the node running?")
        elif "refused" in message:
            effects = "unknown" if sent else "none"
            raise DeviceError(f"{name}: {message['refused']}", effects=effects)
        elif "answer" in message:
            return message["answer"]
