"""The kernel's process: store, kernel, bus, nodes and HTTP, put together."""

from __future__ import annotations

import asyncio
import math
import os
import socket
import sys
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Literal

import msgspec
import structlog

from labos.bootstrap._desk import serving_api_processes
from labos.bootstrap._drivers import load_drivers
from labos.bootstrap._gate import (
    add_first_user,
    expect_tls,
    expect_users,
    give_first_password,
    listening,
    opened_gate,
)
from labos.bootstrap._hands import SimulatedHands
from labos.bootstrap._metrics import LabMetrics
from labos.bootstrap._notify import find_contacts, run_notifier
from labos.bootstrap._secure import Guard, unheard_by_name
from labos.bootstrap._traces import send_traces
from labos.bus import SCHEME, Security, Unheard, ZenohBus, open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.actions import ActionStatus
from labos.core.decide.control import PauseStarts
from labos.core.decide.nodes import HearJournal
from labos.core.decide.shorter import ReportShorterLog
from labos.core.ids import ModuleName, local, workcell_of
from labos.core.lab import WHOLE_LAB
from labos.core.model import Description
from labos.core.shorter import BenchCompared
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import BadInput, BusError, Fenced, StoreError, Unreadable
from labos.http.campaign_rows import CampaignRows
from labos.http.desk import Desk
from labos.http.feed import Feed
from labos.http.finding import Finder
from labos.http.identity import Gate
from labos.http.server import HttpServer
from labos.http.service import LabService
from labos.http.viewers import Viewers
from labos.node.limits import read
from labos.node.protocol import Keys, SetupReply, SetupRequest
from labos.node.world import World
from labos.pki import Identity
from labos.ports import Handle
from labos.private import make_folder
from labos.runtime.announcer import Announcer
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.feeder import Feeder
from labos.runtime.files import FileDesk
from labos.runtime.follower import Follower
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import Entry
from labos.runtime.log_check import LogCheck
from labos.runtime.marks import Marks
from labos.runtime.reconcile import Reconciler
from labos.runtime.registry import Registry
from labos.runtime.spawning import best_spawner
from labos.runtime.supervisor import NodeCommand, Supervisor
from labos.runtime.verify import Verifier
from labos.runtime.writer import ThreadWriter
from labos.services.journals import refuse_lost_log, untold
from labos.settings import (
    KernelInfo,
    Ports,
    Settings,
    announce,
    free_port,
    is_alive,
    is_free,
    last_ports,
    remember_ports,
    was_simulated,
    withdraw,
)
from labos.spec import CompiledWorkcell
from labos.store import (
    Damage,
    SqlEventStore,
    first_damage,
    open_blobs,
    open_store,
    shown_url,
)
from labos.telemetry.otlp import check_receiver
from labos.version import VERSION

Nodes = Literal["processes", "none"]

BUS_PATIENCE_S = 20.0
"""How long a starting kernel waits for a bus that runs by itself. One that has taken over from another waits
for ever: it has the lab, and nobody else would take it back."""

BUS_POLL_S = 0.2

_setup_request = msgspec.json.Decoder(SetupRequest)

CHECKED_AT_ONCE = 50
"""So many records of the log are checked in the background without a pause: less than a millisecond."""

_log = structlog.get_logger(__name__)


class LabRuntime:
    """A running lab, in the process of its kernel. Made by ``open_lab``."""

    bus: ZenohBus
    registry: Registry
    dispatcher: Dispatcher
    announcer: Announcer
    service: LabService
    metrics: LabMetrics
    bus_endpoint: str
    gate: Gate
    http: HttpServer
    desk: Desk
    log_check: LogCheck | None = None
    """The check of the whole log, once it has begun."""
    guard: Guard | None = None
    """The certificates of a secure bus."""

    def __init__(self, settings: Settings, kernel: Kernel, store: SqlEventStore, *, simulated: bool) -> None:
        self.settings, self.kernel, self.store, self.simulated = settings, kernel, store, simulated
        self.clock = kernel.clock
        self.blobs = open_blobs(settings.blobs)
        self.supervised: Supervisor | None = None
        drivers = load_drivers()
        self.descriptions: Mapping[str, Description] = drivers.descriptions()
        self.broken_drivers: Mapping[str, str] = drivers.broken
        for name, why in drivers.broken.items():
            _log.warning("driver_broken", driver=name, why=why)
        self.nodes_from = 0
        """The position in the log after which this kernel's nodes were started."""
        self.cut_short: list[str] = []
        """The actions, with their runs, that had not ended when the lab was closed."""
        self.left_to_standby = False
        """Whether the lab is closed for a standby to go on with."""
        self._unheard: dict[ModuleName, str] = {}
        self._worlds: dict[str, World] = {}
        self._declared: list[Handle] = []
        self._detach = False
        self._following: set[asyncio.Task[None]] = set()

    @property
    def http_url(self) -> str:
        return self.http.url

    def world(self, workcell: str) -> World:
        """The simulated bench of a workcell."""
        if workcell not in self._worlds:
            make_folder(self.settings.worlds)
            self._worlds[workcell] = World(str(self.settings.world(workcell)))
        return self._worlds[workcell]

    async def apply(
        self, cell: CompiledWorkcell, *, declare: bool | None = None, actor: str = "labos"
    ) -> None:
        """Set up a workcell. Unless it is said otherwise, its stock is declared on a simulated bench, not
        on a real one."""
        await self.service.apply(cell, actor, declare=self.simulated if declare is None else declare)

    def start_nodes(self, *, detach: bool = False, only: Sequence[str] = ()) -> None:
        """Start a process for each module of the applied workcells (``only``: for these)."""
        self._detach = detach
        if self.supervised is None:
            self.nodes_from = self.kernel.durable
            folders = self.settings.nodes, self.settings.logs
            for folder in folders:
                make_folder(folder)
            spawner = best_spawner(self.settings.logs / "fork-server.log", is_alive)
            self.supervised = Supervisor(*folders, self.clock, is_alive, detach=detach, spawner=spawner)
        modules = self.kernel.state.modules.by_name
        wanted = [name for name in modules if not only or name in only or local(name) in only]
        self.supervised.start([NodeCommand(str(name), self._argv(name, detach)) for name in wanted])

    async def leave_to_standby(self) -> bool:
        """Whether this lab can be left to a standby: somebody has to stand by, and nodes that end with this
        process would not outlive it. Raises StoreError."""
        standing_by = await asyncio.to_thread(self.store.standbys)
        mortal = self.supervised is not None and not self._detach
        if not standing_by or mortal:
            _log.warning("not_left_to_standby", standing_by=standing_by, nodes_end_with_it=mortal)
            return False
        self.left_to_standby = True
        return True

    def is_stopping(self, module: ModuleName) -> bool:
        """Whether the node of a module was told to end."""
        return self.supervised is not None and self.supervised.is_stopping(module)

    def follow_workcells(self, changed: Sequence[ModuleName] = ()) -> None:
        """Nodes of removed modules end, those of ``changed`` ones are started again as soon as they
        have finished what they are doing, those of new ones are started."""
        if self.supervised is not None:
            task = asyncio.get_running_loop().create_task(self._follow(self.supervised, changed))
            self._following.add(task)
            task.add_done_callback(self._following.discard)

    async def _follow(self, supervisor: Supervisor, changed: Sequence[ModuleName]) -> None:
        known = self.kernel.state.modules.by_name
        old = [name for name in supervisor.nodes if name not in known or name in changed]
        await asyncio.gather(*(supervisor.stop(name) for name in old))
        if self.guard is not None:
            await asyncio.to_thread(self.guard.issue_for, list(known))
        self.start_nodes(detach=self._detach)

    def _argv(self, module: ModuleName, detach: bool) -> tuple[str, ...]:
        spec = self.kernel.state.modules.by_name[module].spec
        driver = [] if "about" in spec.config else [spec.driver]  # no driver describes a foreign node
        return (
            *(sys.executable, "-m", "labos", "node", "start", *driver),
            *("--name", local(module), "--workcell", workcell_of(module)),
            *("--home", str(self.settings.home)),
            *(word for endpoint in self._endpoints for word in ("--connect", endpoint)),
            *(["--cert", str(self.guard.of_node(module))] if self.guard is not None else []),
            *(["--simulate"] if self.simulated else []),
            *(["--wire"] if self.simulated and self.settings.wire else []),
            *(["--trace", str(self.settings.trace(module))] if self.settings.trace_wires else []),
            *(["--metrics-port", "0"] if self.settings.node_metrics else []),
            *([] if detach else ["--with-parent"]),
        )

    @property
    def _endpoints(self) -> tuple[str, ...]:
        return self.settings.bus or (self.bus_endpoint,)

    def note_unheard(self, unheard: Unheard) -> None:
        """Say of modules that their nodes are connected and not heard; and no more of those that are."""
        found, rejected = unheard_by_name(unheard, self.kernel.lab), self.registry.rejected
        for module, why in self._unheard.items():
            if module not in found and rejected.get(module) == why:
                del rejected[module]
        rejected.update(found)
        self._unheard = found

    async def on_setup(self, payload: bytes) -> bytes:
        """A starting node asks what its module is. It is told of this module and of no other."""
        try:
            request = read(payload, _setup_request)
            reply = self._setup(ModuleName(request.module))
        except (Unreadable, StoreError) as error:
            reply = SetupReply(unknown=str(error))
        return msgspec.json.encode(reply)

    async def on_setup_of(self, key: str, payload: bytes) -> bytes:
        """The same on a key of its own for each module, which only its node may ask on a secure bus."""
        try:
            module = read(payload, _setup_request).module
        except Unreadable as error:
            return msgspec.json.encode(SetupReply(unknown=str(error)))
        if key != Keys(self.kernel.lab).setup_of(module):
            return msgspec.json.encode(SetupReply(unknown="this key is that of another module"))
        return await self.on_setup(payload)

    def _setup(self, name: ModuleName) -> SetupReply:
        state = self.kernel.state
        module = state.modules.by_name.get(name)
        if module is None:
            return SetupReply(unknown=f"no workcell of this lab has a module {cut(name, LONGEST_NAME)}")
        told = module.spec.config
        return SetupReply(
            driver=module.spec.driver,
            config=told.get("config", {}),
            poses={**told.get("poses", {}), **module.poses()},
            poses_of=module.poses_of(),
            regrip=local(module.spec.regrip),
            pace=state.lab.pace,
            seed=self.settings.seed,
            simulated=self.simulated,
            interface=told.get("interface", ""),
            about=told.get("about", {}),
            extends=told.get("extends", {}),
            labos=VERSION,
        )

    def close_worlds(self) -> None:
        for world in self._worlds.values():
            world.close()


@asynccontextmanager
async def open_lab(
    settings: Settings,
    *,
    workcells: Sequence[CompiledWorkcell] = (),
    nodes: Nodes = "none",
    detach: bool = False,
    declare: bool | None = None,
    grace_s: float = 30.0,
    follower: Follower | None = None,
) -> AsyncIterator[LabRuntime]:
    """Run a lab as long as the block lasts; watch ``kernel.failed`` meanwhile. A standby gives what its
    ``follower`` has read of the log.

    At the end nodes finish what they are doing (``grace_s`` at the most), what is decided is
    written, and a snapshot is kept. Raises Refused while another kernel runs this lab, or if its log is
    lost and its nodes' journals are there, BusError or BadInput for a port in use, SpecError for the contacts
    file, StoreError, LogTooNew.
    """
    expect_tls(settings)
    if settings.trace_receiver:
        check_receiver(settings.trace_receiver)
    simulated = _is_simulated(settings)
    contacts = find_contacts(settings)
    async with AsyncExitStack() as stack:
        with _folder(settings.home):  # where the lab cannot be opened, nothing is left behind
            store = open_store(settings.database, home=settings.home)
            stack.callback(store.close)
            refuse_lost_log(store, settings.journals, shown_url(settings.database))
            known, ended = store.known_position, store.head().position
            with _folder(settings.worlds if simulated else settings.home):
                kernel, writer = await _open_kernel(settings, store, follower)
        stack.push_async_callback(kernel.close)
        lab = LabRuntime(settings, kernel, store, simulated=simulated)
        stack.callback(lab.close_worlds)
        if simulated:
            kernel.listeners.append(SimulatedHands(lab.world, store, kernel.state))
        await add_first_user(settings, kernel)
        expect_users(settings, kernel)
        lab.metrics = LabMetrics(lab, writer)
        lab.metrics.traces = await stack.enter_async_context(send_traces(settings, kernel))
        stack.push_async_callback(lab.metrics.close)
        lab.blobs.tidy()
        _check_pace(settings, kernel)
        if 0 < ended < known:  # a new lab in an old folder has lost nothing
            kernel.submit(ReportShorterLog(known, "the note in the lab's folder", ended), "labos")
        _hear_journals(settings, store, kernel)
        kernel.listeners.append(_LogEndListener(store))
        await kernel.begin_planning()
        notifier = await stack.enter_async_context(run_notifier(settings, contacts, kernel))
        modules = [*kernel.state.modules.by_name, *(m.name for c in workcells for m in c.workcell.modules)]
        security = await _secure(settings, lab, modules if nodes == "processes" else [])
        await _open_bus(settings, lab, stack, security, math.inf if follower is not None else BUS_PATIENCE_S)
        feed = Feed()
        kernel.listeners.append(feed)
        lab.service = LabService(lab, feed, _viewers(settings))
        lab.service.finder = Finder(settings.database, settings.blobs, settings.home)
        http_port = _port(settings, settings.http_port, last_ports(settings.home).http)
        lab.gate = stack.enter_context(opened_gate(settings, kernel, lab.metrics))
        await give_first_password(settings, lab.gate.accounts)
        lab.service.marks = Marks(store)
        kernel.listeners.append(lab.service.marks)
        lab.service.marks.begin()
        stack.push_async_callback(lab.service.marks.close)
        lab.http = HttpServer(lab.service, lab.gate, listening(settings, http_port))
        await lab.http.start()
        stack.push_async_callback(lab.http.close)
        await stack.enter_async_context(serving_api_processes(settings, lab))
        feeder = Feeder(kernel, CampaignRows(lab.service))
        feeder.start()
        stack.push_async_callback(feeder.close)
        watching = asyncio.get_running_loop().create_task(lab.service.miss_silent())
        stack.callback(watching.cancel)
        for cell in workcells:
            await lab.apply(cell, declare=declare)
        announce(settings.home, _info(settings, lab))
        stack.callback(withdraw, settings.home)
        if nodes == "processes":
            lab.start_nodes(detach=detach)
        lab.log_check = _check_log(settings, kernel)
        lab.log_check.start()
        lab.metrics.start()
        stack.push_async_callback(lab.log_check.close)
        try:
            yield lab
        finally:
            if lab.left_to_standby:
                await kernel.leave_to_standby()
            if notifier is not None:
                notifier.begin_close()
            if lab.supervised is not None and (lab.left_to_standby or _is_fenced(kernel)):
                lab.supervised.leave()
            elif lab.supervised is not None:
                killed = await lab.supervised.close(grace_s)
                await lab.registry.wait_until_left(list(lab.supervised.nodes))
                lab.cut_short = _cut_short(kernel, killed)


def _check_log(settings: Settings, kernel: Kernel) -> LogCheck:
    """Checks the whole log in the background. Once a damage is found nothing is started any more: what the
    lab goes by may never have been so. A person decides what follows."""

    def check(tell: Callable[[int, int], None]) -> Damage | None:
        reader = open_store(settings.database, create=False, read_only=True)
        try:
            return first_damage(reader, tell, every=CHECKED_AT_ONCE)
        finally:
            reader.close()

    def stop_starts(position: int, reason: str) -> None:
        why = f"The log is damaged at position {position}: {reason}. See `labos verify`."
        try:
            kernel.submit(PauseStarts(WHOLE_LAB, "labos", why), "labos")
        except StoreError as error:  # it starts nothing without its log either; the next start looks again
            _log.error("starts_not_paused", why=str(error))

    return LogCheck(check, stop_starts)


def _cut_short(kernel: Kernel, killed: Sequence[str]) -> list[str]:
    """The actions whose nodes were killed before they had ended."""
    try:
        open_ = list(kernel.state.actions.open.values())
    except StoreError:
        return []  # whoever reads the log next finds them
    cut = [action for action in open_ if action.module in killed and action.status != ActionStatus.UNKNOWN]
    return [f"{local(action.module)}.{action.name} of {action.run}" for action in cut]


@contextmanager
def _folder(path: Path) -> Iterator[None]:
    """Make a folder; what of it is new goes again if the block fails, as when another kernel runs the lab."""
    new = make_folder(path)[::-1]
    try:
        yield
    except BaseException:
        for folder in new:
            with suppress(OSError):  # something stands in it
                folder.rmdir()
        raise


def _is_fenced(kernel: Kernel) -> bool:
    """Whether another kernel has taken over: the nodes are its own now."""
    return kernel.failed.done() and isinstance(kernel.failed.result(), Fenced)


async def _open_kernel(
    settings: Settings, store: SqlEventStore, follower: Follower | None
) -> tuple[Kernel, ThreadWriter]:
    owner = f"pid {os.getpid()} on {socket.gethostname()}"
    after, within_s = settings.failures_borne
    chosen = KernelSettings(
        name=settings.name,
        pace=settings.speed or 1.0,
        owner=owner,
        reopen_s=settings.reopen_s,
        quarantine_after=after,
        quarantine_within_s=within_s,
    )
    writer = ThreadWriter(store, silence_s=settings.silence_s)
    kernel = Kernel(writer, SystemClock(), Uuid7Ids(), chosen)
    try:
        await kernel.open(follower, plan=False)
    except BaseException:
        await kernel.close()
        raise
    return kernel, writer


async def _secure(settings: Settings, lab: LabRuntime, modules: Sequence[str]) -> Security | None:
    """The certificates of a secure bus; ``modules`` are those whose nodes run here. Raises NotFound, Refused,
    BadInput."""
    if not settings.is_secure:
        return None

    def run_here() -> list[str]:
        return list(lab.supervised.nodes) if lab.supervised is not None else []

    lab.guard = Guard(
        Identity("kernel", lab=lab.kernel.lab),
        settings,
        runs_bus=not settings.bus,
        own=settings.certificate,
        modules=run_here,
        tell=lab.note_unheard,
    )
    return await asyncio.to_thread(lab.guard.prepare, modules)


async def _join_bus(endpoints: Sequence[str], patience_s: float, security: Security | None) -> ZenohBus:
    """The bus that runs by itself, as soon as somebody answers there: after a power cut it may be the last to
    start. Raises BusError if nobody does for ``patience_s``."""
    now, told = asyncio.get_running_loop().time, False
    give_up = now() + patience_s
    while True:
        try:
            return await open_bus(mode="client", connect=endpoints, security=security)
        except BusError as error:
            if now() >= give_up:
                raise
            if not told:
                _log.warning("waiting_for_the_bus", why=error.message)
            told = True
        await asyncio.sleep(BUS_POLL_S)


async def _open_bus(
    settings: Settings,
    lab: LabRuntime,
    stack: AsyncExitStack,
    security: Security | None,
    patience_s: float,
) -> None:
    """The router that everybody connects to, unless one runs by itself; and what the kernel says and
    hears there."""
    if settings.bus:
        lab.bus_endpoint = settings.bus[0]
        lab.bus = await _join_bus(settings.bus, patience_s, security)
    else:
        port = _port(settings, settings.bus_port, last_ports(settings.home).bus) or free_port(settings.host)
        scheme = SCHEME if security is not None else "tcp/"
        listening = f"{scheme}{settings.host}:{port}"
        # No certificate is one for every address.
        dialled = "127.0.0.1" if security is not None and settings.host == "0.0.0.0" else settings.host
        lab.bus_endpoint = f"{scheme}{dialled}:{port}"
        lab.bus = await open_bus(mode="router", listen=[listening], security=security)
    stack.push_async_callback(lab.bus.close)
    if lab.guard is not None:
        await lab.guard.watch(lab.bus)
        stack.push_async_callback(lab.guard.close)
    keys = Keys(lab.kernel.lab)
    lab.dispatcher = Dispatcher(lab.kernel, lab.bus)
    lab.registry = Registry(lab.kernel, lab.bus, lab.dispatcher, is_stopping=lab.is_stopping)
    await lab.dispatcher.start()
    stack.push_async_callback(lab.dispatcher.close)
    lab.announcer = Announcer(lab.kernel, lab.bus)
    await lab.announcer.start()
    stack.push_async_callback(lab.announcer.close)
    await lab.registry.start()
    stack.push_async_callback(lab.registry.close)
    reconciler = Reconciler(lab.kernel, lab.bus)
    reconciler.start()
    stack.callback(reconciler.close)
    verifier = Verifier(lab.kernel, lab.bus)
    verifier.start()
    stack.callback(verifier.close)
    await lab.bus.serve(keys.setup, lab.on_setup)
    await lab.bus.serve_all(keys.all_setups, lab.on_setup_of)
    await lab.bus.serve(keys.files, FileDesk(lab.blobs, settings.arriving).on_request)
    await lab.bus.declare_alive(keys.kernel)


def _port(settings: Settings, wanted: int | None, last: int) -> int:
    """The port asked for, else the last one if it is free, else 0 for any."""
    if wanted is not None:
        return wanted
    return last if last and is_free(last, settings.host) else 0


def _is_simulated(settings: Settings) -> bool:
    """As asked for, else as it has been. Raises BadInput for a lab that was the other kind."""
    was = was_simulated(settings)
    wanted = bool(was) if settings.simulate is None else settings.simulate
    if was is not None and wanted != was:
        kinds = ("real", "simulated")
        raise BadInput(
            f"The lab in {settings.home} is {kinds[was]}; it cannot go on as a {kinds[wanted]} one.",
            remedy="Its log would not be true of the other bench. Use another --home.",
        )
    return wanted


def _viewers(settings: Settings) -> Viewers | None:
    """The process for those who follow the log, where a connection can be handed to another process."""
    return Viewers(settings.database) if sys.platform != "win32" else None


class _LogEndListener:
    """Tells the store when a person has compared the bench with the log: the same loss is not asked about at
    the next start."""

    def __init__(self, store: SqlEventStore) -> None:
        self._store = store

    def committed(self, entries: Sequence[Entry]) -> None:
        if any(isinstance(entry.event, BenchCompared) for entry in entries):
            self._store.accept_end()

    def reopened(self) -> None:
        pass


def _hear_journals(settings: Settings, store: SqlEventStore, kernel: Kernel) -> None:
    """What the journals in the lab's folder know more than the log is known before anything can start."""
    for module, found, beyond in untold(store, settings.journals):
        kernel.submit(HearJournal(module, tuple(found), beyond), str(module))


def _check_pace(settings: Settings, kernel: Kernel) -> None:
    pace = kernel.state.lab.pace
    if settings.speed is not None and settings.speed != pace:
        raise BadInput(
            f"This lab runs at speed {pace:g} since it was created, not at {settings.speed:g}.",
            remedy="Leave --speed out, or use another --home.",
        )


def _info(settings: Settings, lab: LabRuntime) -> KernelInfo:
    own_bus = 0 if settings.bus else int(lab.bus_endpoint.rpartition(":")[2])
    remember_ports(settings.home, Ports(lab.http.port, own_bus))
    return KernelInfo(
        pid=os.getpid(),
        url=lab.http_url,
        bus=lab.bus_endpoint,
        lab=lab.kernel.lab,
        database=settings.database,
        simulated=lab.simulated,
        speed=lab.kernel.state.lab.pace,
        blobs=str(settings.blobs),
        certificate=str(Path(settings.tls_certificate).absolute()) if settings.tls_certificate else "",
    )
