"""Keeps the processes of a lab's nodes running, and finds those that a dead kernel left behind.

A node ends when its standard input ends, so nodes end with their kernel, whatever the reason, after they have
finished their present actions. Detached nodes continue; the next kernel finds them through the notes in
``<home>/nodes``. A kernel may die between the start of a node and its note; then the node is found as the
process that has the module's journal open.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import structlog

from labos.clock import Clock
from labos.core.ids import local
from labos.node.journal_file import find_process
from labos.runtime.spawning import Child, ExitCode, PlainSpawner, Spawner

POLL_S = 0.1
GRACE_S = 30.0
"""How long nodes may continue their present actions when the lab is closed."""

QUICK_S = 5.0
"""A node that ends within this time of its start has failed to start."""

END_WITH_PARENT = "--with-parent"
"""The word in the command of a node that ends with its kernel."""

_log = structlog.get_logger(__name__)


class NodeCommand(msgspec.Struct, frozen=True):
    """How to start the node of ``workcell/module``."""

    module: str
    argv: tuple[str, ...]


class NodeProcess(msgspec.Struct):
    """The present process of a node. ``pid`` 0: none."""

    module: str
    state: Literal["starting", "running", "failed", "quarantined", "stopped"] = "starting"
    pid: int = 0
    starts: int = 0
    failures: int = 0
    why: str = ""


class _Note(msgspec.Struct):
    """The note about a process for the next kernel."""

    module: str
    pid: int
    detached: bool


class Supervisor:
    """Starts nodes and restarts crashed ones. A node that fails ``patience`` times in a row directly after
    its start is not started again. ``is_alive`` tells whether a process with that id exists,
    ``find_journal`` where the journal of a module is."""

    def __init__(
        self,
        notes: Path,
        logs: Path,
        clock: Clock,
        is_alive: Callable[[int], bool],
        find_journal: Callable[[str], Path],
        *,
        detach: bool = False,
        patience: int = 5,
        spawner: Spawner | None = None,
    ) -> None:
        self._is_alive, self._find_journal = is_alive, find_journal
        self._spawner = spawner or PlainSpawner()
        self._notes, self._logs, self._clock = notes, logs, clock
        self._detach, self._patience = detach, patience
        self.nodes: dict[str, NodeProcess] = {}
        self._children: dict[str, Child] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._closing = False
        self._dropped: set[str] = set()
        self._hurry = asyncio.Event()

    def start(self, commands: Sequence[NodeCommand]) -> None:
        """Keep these nodes running from now on; those known already are not touched."""
        self._notes.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._logs.mkdir(mode=0o700, parents=True, exist_ok=True)
        for command in commands:
            if command.module not in self._tasks:
                node = self.nodes[command.module] = NodeProcess(command.module)
                self._tasks[command.module] = asyncio.get_running_loop().create_task(
                    self._keep(command, node)
                )

    def find_log(self, module: str) -> Path:
        return self._logs / f"{module.replace('/', '.')}.log"

    def hurry(self) -> None:
        """Do not let the nodes finish their present actions."""
        self._hurry.set()

    async def close(self, grace_s: float = GRACE_S) -> list[str]:
        """Stop every node: each may finish its present actions, but no longer than ``grace_s``. Returns the
        modules whose nodes were killed then."""
        self._closing = True
        killed = []
        for node in self.nodes.values():
            self._ask_to_stop(node)
        tasks = list(self._tasks.values())
        if tasks:
            hurry = asyncio.ensure_future(self._hurry.wait())
            everybody: asyncio.Future[Any] = asyncio.gather(*tasks, return_exceptions=True)
            ends: set[asyncio.Future[Any]] = {hurry, everybody}
            await asyncio.wait(ends, timeout=grace_s, return_when=asyncio.FIRST_COMPLETED)
            hurry.cancel()
            for node in self.nodes.values():
                if node.pid:
                    _log.warning("node_killed", module=node.module, pid=node.pid)
                    killed.append(node.module)
                    _send_signal(node.pid, kill=True)
            await everybody
        self._spawner.close()
        return killed

    def leave(self) -> None:
        """Supervise no node any more, and leave every node as it is: it obeys another kernel."""
        self._closing = True
        for task in self._tasks.values():
            task.cancel()
        self._spawner.close()

    async def stop(self, module: str) -> None:
        """Stop a node: it finishes its present actions, and is not started again."""
        node, task = self.nodes.get(module), self._tasks.get(module)
        if node is None or task is None:
            return
        self._dropped.add(module)
        self._ask_to_stop(node)
        await task
        self._dropped.discard(module)
        del self.nodes[module], self._tasks[module]

    def is_stopping(self, module: str) -> bool:
        """Whether its node was ordered to end, and is not started again."""
        return self._closing or module in self._dropped

    # -- one node ----------------------------------------------------------------------------

    async def _keep(self, command: NodeCommand, node: NodeProcess) -> None:
        while not self.is_stopping(command.module) and node.state != "quarantined":
            survivor = self._find_survivor(command.module)
            began = self._clock.monotonic()
            if survivor is not None:
                node.pid = survivor.pid
                node.state = "running" if survivor.detached else "starting"
                node.why = "" if survivor.detached else "its predecessor finishes its actions"
                while self._is_alive(survivor.pid):  # noqa: ASYNC110 (it is not our child: nothing tells)
                    await asyncio.sleep(POLL_S)
                code: ExitCode = 0
            else:
                child = await self._spawn(command, node)
                if child is None:
                    return
                while (ended := child.poll()) is None:  # noqa: ASYNC110 (cheaper than a thread each)
                    await asyncio.sleep(POLL_S)
                code = ended
                self._children.pop(command.module).close_stdin()
            node.pid = 0
            with contextlib.suppress(OSError):
                self._note_file(command.module).unlink()
            if self.is_stopping(command.module):
                break
            if survivor is None or survivor.detached:
                await self._judge(node, code, self._clock.monotonic() - began)
        if node.state != "quarantined":
            node.state = "stopped"

    async def _judge(self, node: NodeProcess, code: ExitCode, lasted_s: float) -> None:
        """A node ended without an order: start it again after a while, or stop trying."""
        node.failures = node.failures + 1 if lasted_s < QUICK_S else 1
        node.why = self._read_last_line(node.module) or f"it ended with code {code}"
        _log.warning("node_ended", module=node.module, code=code, lasted_s=round(lasted_s, 1), why=node.why)
        if node.failures >= self._patience:
            node.state = "quarantined"
            _log.error("node_quarantined", module=node.module, failures=node.failures, why=node.why)
            return
        node.state = "failed"
        await asyncio.sleep(min(0.2 * 2 ** (node.failures - 1), 10.0))

    async def _spawn(self, command: NodeCommand, node: NodeProcess) -> Child | None:
        try:
            child = await self._spawner.spawn(
                command.argv, self.find_log(command.module), attended=not self._detach
            )
        except OSError as error:
            node.state, node.why = "quarantined", f"it cannot be started: {error}"
            _log.error("node_not_started", module=command.module, error=str(error))
            return None
        self._children[command.module] = child
        node.pid, node.state, node.starts = child.pid, "running", node.starts + 1
        self._write_note(_Note(command.module, child.pid, self._detach))
        if self.is_stopping(command.module):
            self._ask_to_stop(node)  # the stop was requested during its start
        return child

    def _ask_to_stop(self, node: NodeProcess) -> None:
        child = self._children.get(node.module)
        if child is not None and not self._detach:
            child.close_stdin()
        elif node.pid:
            _send_signal(node.pid)

    # -- processes of an earlier kernel ------------------------------------------------------

    def _note_file(self, module: str) -> Path:
        return self._notes / f"{module.replace('/', '.')}.json"

    def _write_note(self, note: _Note) -> None:
        with contextlib.suppress(OSError):
            self._note_file(note.module).write_bytes(msgspec.json.encode(note))

    def _read_note(self, module: str) -> _Note | None:
        try:
            note = msgspec.json.decode(self._note_file(module).read_bytes(), type=_Note)
        except (OSError, msgspec.MsgspecError):
            return None
        return note if note.module == module else None

    def _find_survivor(self, module: str) -> _Note | None:
        """The process of this node that is still running, if an earlier kernel or a person started it."""
        note = self._read_note(module)
        if note is not None and self._is_node(note.pid, module):
            return note
        pid = find_process(self._find_journal(module))
        if not self._is_node(pid, module):
            return None
        _log.warning("node_found_by_journal", module=module, pid=pid)
        found = _Note(module, pid, detached=END_WITH_PARENT not in _read_words(pid))
        self._write_note(found)
        return found

    def _is_node(self, pid: int, module: str) -> bool:
        """Whether the process runs and is a node of this module, and not another process with that id."""
        # Without words, this system does not show them, or the process has just been made.
        return self._is_alive(pid) and local(module) in (_read_words(pid) or [local(module)])

    def _read_last_line(self, module: str) -> str:
        """The last line of the node's log."""
        try:
            with self.find_log(module).open("rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - 4096))
                lines = log.read().decode(errors="replace").strip().splitlines()
        except OSError:
            return ""
        return lines[-1].strip() if lines else ""


def _read_words(pid: int) -> list[str]:
    """The words of the command of a process; empty if they are not known."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return []
    return command.decode(errors="replace").replace("\0", " ").split()


def _send_signal(pid: int, *, kill: bool = False) -> None:
    import signal

    number = getattr(signal, "SIGKILL", signal.SIGTERM) if kill else signal.SIGTERM
    with contextlib.suppress(OSError):
        os.kill(pid, number)
