"""The process of one node: from the lab's address to a module that answers."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Coroutine, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import structlog

from labos.bootstrap._drivers import load_driver
from labos.bootstrap._node_class import find_foreign_class, find_own_class
from labos.bootstrap._node_security import check_lab, keep_certificate, read_node_security
from labos.bootstrap._node_settings import with_own_settings
from labos.clock import SystemClock, Uuid7Ids
from labos.core.structs import make_from
from labos.errors import BadInput, BusError, NoAnswer, Unreadable
from labos.node.files import Files
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.limits import REPLY_LIMIT, read
from labos.node.node import Node, Setup
from labos.node.protocol import ANY_KERNEL, Keys, SetupReply, SetupRequest, explain_skew
from labos.node.server import NodeServer
from labos.node.world import World
from labos.private import make_folder
from labos.settings import Settings, find_kernel

if TYPE_CHECKING:
    from labos.bus import Security, ZenohBus
    from labos.ports import Bus
    from labos.telemetry.node import MetricsServer

T = TypeVar("T")
Address = tuple[str, int]
"""A host and a port; port 0 means any free one."""

FINISH_S = 30.0
"""How long a simulated action may continue when its node is asked to stop (seconds). A real device's action
is never broken off because its process should end."""

OWN_LAB_S = 5.0
"""How long a node looks for the kernel of its own lab while kernels of other labs live on the bus."""

NO_KERNEL_S = 10.0
"""If no kernel answers for this time, a node reports that it waits for one."""

OTHER_LABS_S = 0.5
"""How long a node without a lab checks whether there are several labs."""

_log = structlog.get_logger(__name__)
_setup_reply = msgspec.json.Decoder(SetupReply)


async def run_node(
    driver: str | type[Node],
    name: str,
    workcell: str,
    settings: Settings,
    *,
    connect: Sequence[str] = (),
    certificate: Path | None = None,
    secure: bool = False,
    simulate: bool = False,
    wire: bool = False,
    trace: str = "",
    metrics: Address | None = None,
    with_parent: bool = False,
    finish_s: float | None = None,
) -> None:
    """Represent ``workcell/name`` until asked to stop. If ``driver`` is empty, the workcell names it.

    ``connect`` are addresses of the lab's bus; if empty, the bus of the lab in the home folder is used.
    ``certificate`` is the folder of the node's certificate for a secure bus; if empty, the one in the lab's
    folder is used. ``secure``: only a secure bus is joined. The node waits for a lab that is not running yet,
    and continues when its kernel is restarted. ``wire``: a simulated device is reached over a simulated wire.
    ``trace`` names a file for every byte on the wire. ``metrics`` is the address for Prometheus.
    ``with_parent``: the node ends when its standard input is closed. When the node is asked to stop, it first
    completes its actions, within ``finish_s``. When it is asked twice, it ends at once. Raises NotFound,
    BadInput, JournalError, JournalDamaged, NameTaken.
    """
    ends = _Ends()
    ends.listen(with_parent)
    module = f"{workcell}/{name}"
    if trace:
        _switch_trace(Path(trace), on=True)
    node_class = driver if isinstance(driver, type) else load_driver(driver) if driver else None
    journal = await Journal.open(FileJournalFile(settings.journal(module)), Uuid7Ids())
    bus: ZenohBus | None = None
    server: NodeServer | None = None
    shown: MetricsServer | None = None
    keeping: asyncio.Task[None] | None = None
    try:
        joined = await ends.wait_unless_stopped(_join_bus(settings, module, connect, certificate, secure))
        if joined is None:
            return
        bus, security, belongs_to = joined
        known = journal.memory.lab or belongs_to or _lab_of(settings, connect)
        check_lab(module, known, belongs_to)
        lab = await ends.wait_unless_stopped(find_lab(bus, module, known))
        reply = (
            await ends.wait_unless_stopped(_learn(bus, lab, module, security is not None)) if lab else None
        )
        if lab is None or reply is None:
            return
        if skew := explain_skew(reply.protocol, "The lab's kernel", reply.labos):
            raise BadInput(skew)
        if simulate != reply.simulated:
            ours, theirs = ("simulated", "real") if simulate else ("real", "simulated")
            raise BadInput(
                f"This node would be {ours}, but the lab's bench is {theirs}.",
                remedy="Start it with --simulate." if reply.simulated else "Start it without --simulate.",
            )
        # On a simulated bench, a device is reached at its address only if its configuration declares it a
        # simulator.
        reached = not simulate or reply.config.get("simulator") is True
        foreign = reached and reply.interface not in ("", "native")
        reply = with_own_settings(reply, settings.node_settings, module)
        node_class = (
            find_foreign_class(module, reply) if foreign else find_own_class(module, reply, node_class)
        )
        node = node_class(_make_setup(name, workcell, settings, reply, simulate, wire))
        files = Files(bus, Keys(lab).files, settings.files(module))
        switch = partial(_switch_trace, Path(trace or settings.trace(module)))
        shown = _show_metrics(metrics, node_class, simulate) if metrics is not None else None
        server = NodeServer(
            node,
            bus,
            lab,
            journal,
            SystemClock(),
            Uuid7Ids(),
            files=files,
            trace=switch,
            metrics=shown.address if shown is not None else "",
            on_end=shown.metrics.on_end if shown is not None else None,
        )
        if shown is not None:
            shown.metrics.watch(server.state, asyncio.get_running_loop())
        await server.start()
        _log.info("node_started", module=module, lab=lab, status=server.status)
        if security is not None:
            keeping = asyncio.create_task(keep_certificate(bus, security, server.is_at_work))
        asked = asyncio.create_task(server.stopping.wait())
        await asyncio.wait({asked, ends.make_first_task()}, return_when=asyncio.FIRST_COMPLETED)
        asked.cancel()
        limit = finish_s if finish_s is not None else FINISH_S if simulate else None
        await ends.wait_unless_hurried(server.retire(), limit)
        _log.info("node_stopped", module=module)
    finally:
        if keeping is not None:
            keeping.cancel()
        if shown is not None:
            await asyncio.to_thread(shown.close)
        await (server.close() if server is not None else journal.close())
        if bus is not None:
            await bus.close()


def _switch_trace(file: Path, on: bool) -> str:
    """Begin or end the transcript of every link of this node in a file. Raises BadInput."""
    from labos.link import start_recording, stop_recording

    if on:
        make_folder(file.parent)
        start_recording(file)
    else:
        stop_recording()
    return str(file)


def _show_metrics(at: Address, node_class: type[Node], simulated: bool) -> MetricsServer:
    """Raises BadInput for an address that cannot be used."""
    # Most nodes publish no metrics and need not load this code.
    from labos.telemetry.node import MetricsServer, NodeMetrics

    return MetricsServer(NodeMetrics(node_class.driver, node_class.version, simulated=simulated), *at)


def _make_setup(
    name: str, workcell: str, settings: Settings, reply: SetupReply, simulate: bool, wire: bool
) -> Setup:
    world = None
    if simulate:
        path = settings.world(workcell)
        make_folder(path.parent)
        world = World(str(path))
    return make_from(
        Setup,
        reply,
        name=name,
        workcell=workcell,
        world=world,
        wire=wire,
        unit_file=str(settings.unit(f"{workcell}/{name}")),
    )


async def _join_bus(
    settings: Settings, module: str, connect: Sequence[str], certificate: Path | None, secure: bool
) -> tuple[ZenohBus, Security | None, str]:
    """The bus, as soon as it answers; on a secure one also the node's certificate, and the lab for which it
    is valid. Raises NotFound, BadInput for a certificate that cannot be used."""
    from labos.bus import open_bus

    pause, logged = 0.1, ""
    while True:
        found = None if connect else find_kernel(settings.home)
        where = list(connect) or ([found.bus] if found is not None else [])
        try:
            if where:
                lab = _lab_of(settings, connect)
                security, belongs_to = read_node_security(
                    settings, module, lab, where, certificate, secure=secure
                )
                return await open_bus(mode="client", connect=where, security=security), security, belongs_to
            why = f"no lab runs in {settings.home}"
        except BusError as error:
            why = str(error)
        if why != logged:
            _log.warning("waiting_for_the_lab", why=why)
            logged = why
        await asyncio.sleep(pause)
        pause = min(pause * 2, 2.0)


def _lab_of(settings: Settings, connect: Sequence[str]) -> str:
    """The lab that runs in this home folder; empty if the node has other addresses, or if none runs."""
    kernel = find_kernel(settings.home)
    return kernel.lab if kernel is not None and (not connect or kernel.bus in connect) else ""


async def find_lab(bus: Bus, module: str, known: str) -> str:
    """The id of the lab whose kernel lives on this bus. ``known`` is the lab to which the journal belongs, or
    whose kernel started this node; empty if there is none. Raises BadInput if only another lab lives here, or
    if there are several and none is known."""
    found: dict[str, bool] = {}
    seen, right = asyncio.Event(), asyncio.Event()

    def note(key: str, living: bool) -> None:
        parts = key.split("/")
        if living and len(parts) == 3 and "*" not in key:  # any process can show a key
            found[parts[1]] = True
            seen.set()
            if parts[1] == known:
                right.set()

    watch = await bus.watch_alive(ANY_KERNEL, note)
    try:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(seen.wait(), NO_KERNEL_S)
        if not seen.is_set():
            why = "no kernel was found on this bus, or a secure bus does not accept this certificate (yet)"
            _log.warning("waiting_for_the_kernel", module=module, why=why)
        await seen.wait()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(right.wait(), OWN_LAB_S if known else OTHER_LABS_S)
    finally:
        watch.close()
    if known in found:
        return known
    here = ", ".join(name[:80] for name in list(found)[:5])
    if known:
        raise BadInput(
            f"The journal of {module} belongs to the lab {known}, but the kernel here runs the lab {here}.",
            remedy="Use another --home for another lab, or --connect to the right one.",
        )
    if len(found) > 1:
        raise BadInput(
            f"Several labs have kernels on this bus ({here}): {module} cannot find out which one is its own.",
            remedy="Give each lab its own bus, or find out which program poses as a kernel there.",
        )
    return next(iter(found))


async def _learn(bus: ZenohBus, lab: str, module: str, secure: bool = False) -> SetupReply:
    """The kernel's data about the module, as soon as it has any."""
    logged = ""
    key = Keys(lab).setup_of(module) if secure else Keys(lab).setup
    while True:
        try:
            answer = await bus.query(key, msgspec.json.encode(SetupRequest(module)), 5.0)
            reply = read(answer, _setup_reply, limit=REPLY_LIMIT)
            if not reply.unknown:
                return reply
            why = reply.unknown
        except (NoAnswer, Unreadable) as error:
            why = str(error)
        except (msgspec.MsgspecError, ValueError, RecursionError) as error:
            why = f"the kernel's answer cannot be read ({error})"
        if why != logged:
            _log.warning("waiting_for_the_workcell", module=module, why=why)
            logged = why
        await asyncio.sleep(0.5)


class _Ends:
    """A request to end the node: by a signal, or by closing its standard input."""

    def __init__(self) -> None:
        self._first, self._second = asyncio.Event(), asyncio.Event()
        self._loop = asyncio.get_running_loop()

    def listen(self, with_parent: bool) -> None:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT):
                try:
                    self._loop.add_signal_handler(number, self.ask)
                except NotImplementedError:  # Windows
                    signal.signal(number, lambda *_: self._loop.call_soon_threadsafe(self.ask))
        if with_parent:
            threading.Thread(target=self._await_parent, name="parent", daemon=True).start()

    def ask(self) -> None:
        (self._second if self._first.is_set() else self._first).set()

    def _await_parent(self) -> None:
        fd = sys.stdin.fileno()
        with contextlib.suppress(OSError):
            while os.read(fd, 1024):
                pass
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._first.set)

    def make_first_task(self) -> asyncio.Task[bool]:
        return self._loop.create_task(self._first.wait())

    async def wait_unless_stopped(self, work: Coroutine[Any, Any, T]) -> T | None:
        """The result of the work; None if the node has to end before."""
        return await self._wait_unless(self._first, work, None)

    async def wait_unless_hurried(self, work: Coroutine[Any, Any, T], limit_s: float | None) -> T | None:
        """The result of the work; None if it takes too long, or if the node is asked to end again."""
        return await self._wait_unless(self._second, work, limit_s)

    async def _wait_unless(
        self, event: asyncio.Event, work: Coroutine[Any, Any, T], limit_s: float | None
    ) -> T | None:
        task, asked = self._loop.create_task(work), self._loop.create_task(event.wait())
        await asyncio.wait({task, asked}, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
        asked.cancel()
        if task.done():
            return task.result()
        task.cancel()
        await asyncio.wait({task})
        return None
