"""Starts the processes of nodes: each with a new interpreter, or as forks of one that has loaded
everything."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Literal, Protocol

import msgspec
import structlog

from labos.runtime.fork_server import PACKET, Answer, ChildEnded, StartChild
from labos.runtime.writer import settle

PYTHON = (sys.executable, "-m", "labos")
"""The first words of a command that the fork server can carry out."""

PATIENCE_S = 30.0
"""How long the fork server may take to start, and for each child."""

CODE_UNKNOWN: Final = "unknown"
"""The code of a process whose end was not reported."""

ExitCode = int | Literal["unknown"]
"""The code with which a process ended, as ``subprocess`` gives it: negative for a signal."""

_log = structlog.get_logger(__name__)


class Child(Protocol):
    """A process that was started here."""

    @property
    def pid(self) -> int: ...

    def poll(self) -> ExitCode | None:
        """The code with which it ended; None while it runs."""

    def close_stdin(self) -> None:
        """Close its standard input, so that it works without supervision."""


class Spawner(Protocol):
    """Starts processes. ``attended`` ones read a standard input that ends when they are released, or when
    their parent dies."""

    async def spawn(self, argv: Sequence[str], log: Path, *, attended: bool) -> Child:
        """Raises OSError."""

    def close(self) -> None:
        """Start no more processes; those that were started continue."""


class PlainChild:
    """A process with an interpreter of its own."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self.pid = process.pid

    def poll(self) -> ExitCode | None:
        return self._process.poll()

    def close_stdin(self) -> None:
        if self._process.stdin is not None:
            self._process.stdin.close()


class PlainSpawner:
    """Starts an interpreter for each process. It works everywhere."""

    async def spawn(self, argv: Sequence[str], log: Path, *, attended: bool) -> Child:
        with log.open("ab") as file:
            return PlainChild(
                subprocess.Popen(  # noqa: ASYNC220 (it waits for nothing)
                    argv,
                    stdin=subprocess.PIPE if attended else subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    env=make_environment(),
                    # A Ctrl-C in the terminal is meant for the kernel, which stops its nodes.
                    start_new_session=sys.platform != "win32",
                    creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
                )
            )

    def close(self) -> None:
        pass


class ForkedChild:
    """A fork of the server. While the server runs, it reports how the child ended; later, only the fact that
    it ended is known."""

    def __init__(self, pid: int, stdin: int, is_alive: Callable[[int], bool]) -> None:
        self.pid = pid
        self.code: ExitCode | None = None
        self.orphan = False
        self._stdin, self._is_alive = stdin, is_alive

    def poll(self) -> ExitCode | None:
        if self.code is None and self.orphan and not self._is_alive(self.pid):
            self.code = CODE_UNKNOWN
        return self.code

    def close_stdin(self) -> None:
        if self._stdin >= 0:
            os.close(self._stdin)
            self._stdin = -1


class ForkServer:
    """Starts processes as forks of one that has loaded ``labos node`` (``fork_server``). A command that the
    server cannot carry out is started with a new interpreter, and so is every command while the server does
    not answer. If the server dies, its children continue, and the next process gets a new server."""

    def __init__(self, log: Path, is_alive: Callable[[int], bool], patience_s: float = PATIENCE_S) -> None:
        self._log, self._is_alive, self._patience_s = log, is_alive, patience_s
        self._plain = PlainSpawner()
        self._server: subprocess.Popen[bytes] | None = None
        self._link: socket.socket | None = None
        self._asked: deque[tuple[asyncio.Future[ForkedChild], int]] = deque()
        self._children: dict[int, ForkedChild] = {}

    @property
    def pid(self) -> int:
        """The server's process; 0: none."""
        return self._server.pid if self._server is not None else 0

    async def spawn(self, argv: Sequence[str], log: Path, *, attended: bool) -> Child:
        if tuple(argv[: len(PYTHON)]) == PYTHON:
            try:
                async with asyncio.timeout(self._patience_s):
                    return await self._fork(tuple(argv[len(PYTHON) :]), log, attended=attended)
            except (OSError, TimeoutError) as error:
                why = str(error) or f"it did not answer for {self._patience_s:g} s"
                _log.warning("fork_server_failed", why=why)
                self._give_up(why)
        return await self._plain.spawn(argv, log, attended=attended)

    def close(self) -> None:
        self._give_up("it is no longer needed")

    def _begin(self) -> socket.socket:
        """The link to the server, which is started if it does not run."""
        if self._link is not None:
            return self._link
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with theirs, self._log.open("ab") as log:
                self._server = subprocess.Popen(
                    (*PYTHON, "node", "fork-server", str(theirs.fileno())),
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    env=make_environment(),
                    start_new_session=True,
                    pass_fds=(theirs.fileno(),),
                )
        except OSError:
            ours.close()
            raise
        ours.setblocking(False)
        self._link = ours
        asyncio.get_running_loop().add_reader(ours, self._on_answers)
        return ours

    async def _fork(self, words: tuple[str, ...], log: Path, *, attended: bool) -> ForkedChild:
        link = self._begin()
        answer: asyncio.Future[ForkedChild] = asyncio.get_running_loop().create_future()
        read, write = os.pipe() if attended else (os.open(os.devnull, os.O_RDONLY), -1)
        try:
            with log.open("ab") as file:
                # A packet is sent completely or not at all; the queue holds more packets than a lab has
                # nodes.
                socket.send_fds(link, [msgspec.json.encode(StartChild(words))], [read, file.fileno()])
        except BaseException:
            _close(write)
            raise
        finally:
            os.close(read)
        self._asked.append((answer, write))
        return await answer

    def _on_answers(self) -> None:
        while self._link is not None:
            try:
                packet = self._link.recv(PACKET)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet:
                self._give_up("it has ended")
                return
            self._on_answer(msgspec.json.decode(packet, type=Answer))

    def _on_answer(self, answer: Answer) -> None:
        if isinstance(answer, ChildEnded):
            child = self._children.pop(answer.pid, None)
            if child is not None:
                child.code = answer.code
            return
        asked, stdin = self._asked.popleft()
        if not answer.pid:
            _close(stdin)
            settle(asked, None, OSError(answer.why))
            return
        child = self._children[answer.pid] = ForkedChild(answer.pid, stdin, self._is_alive)
        if asked.done():
            child.close_stdin()  # the caller was cancelled
        else:
            asked.set_result(child)

    def _give_up(self, why: str) -> None:
        """Send nothing more to this server."""
        link, self._link = self._link, None
        server, self._server = self._server, None
        if link is None or server is None:
            return
        asyncio.get_running_loop().remove_reader(link)
        link.close()
        server.kill()
        server.wait()
        for child in self._children.values():
            child.orphan = True
        self._children.clear()
        asked, self._asked = self._asked, deque()
        for answer, stdin in asked:
            _close(stdin)
            settle(answer, None, OSError(f"The fork server is given up: {why}."))


def make_environment() -> dict[str, str]:
    """The environment of a node's process."""
    return {"LABOS_LOG": "info", **os.environ}


def _close(fd: int) -> None:
    if fd >= 0:
        os.close(fd)


def choose_spawner(log: Path, is_alive: Callable[[int], bool]) -> Spawner:
    """Forks where that is safe: on Linux. On other systems, some system libraries do not support it."""
    return ForkServer(log, is_alive) if sys.platform == "linux" else PlainSpawner()
