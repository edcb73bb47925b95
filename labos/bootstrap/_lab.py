"""The kernel's process, composed of store, kernel, bus, nodes and HTTP."""

from __future__ import annotations

import asyncio
import math
import os
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Literal

import structlog

from labos.bootstrap._bus import BUS_PATIENCE_S, choose_port, open_lab_bus, secure_bus
from labos.bootstrap._desk import serve_api_processes
from labos.bootstrap._gate import (
    add_first_user,
    describe_listening,
    expect_tls,
    expect_users,
    follow_marks,
    give_first_password,
    lay_home_key,
    make_service,
    open_gate,
)
from labos.bootstrap._hands import SimulatedHands
from labos.bootstrap._metrics import LabMetrics
from labos.bootstrap._notify import find_contacts, run_notifier
from labos.bootstrap._runtime import LabRuntime
from labos.bootstrap._traces import send_traces
from labos.clock import SystemClock, Uuid7Ids
from labos.core.actions import ActionStatus
from labos.core.decide.control import PauseStarts
from labos.core.decide.nodes import HearJournal
from labos.core.decide.shorter import ReportShorterLog
from labos.core.ids import local
from labos.core.lab import WHOLE_LAB
from labos.core.shorter import BenchCompared
from labos.core.structs import make_from
from labos.errors import BadInput, Fenced, StoreError
from labos.http.campaign_rows import CampaignRows
from labos.http.server import HttpServer
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.private import make_folder
from labos.runtime.feeder import Feeder
from labos.runtime.follower import Follower
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings, OnEvents
from labos.runtime.log_check import LogCheck
from labos.runtime.writer import ThreadWriter
from labos.services.journals import find_unlogged, refuse_lost_log
from labos.settings import (
    KernelInfo,
    Ports,
    Settings,
    announce,
    last_ports,
    remember_ports,
    was_simulated,
    withdraw,
)
from labos.spec import CompiledWorkcell
from labos.store import Damage, SqlEventStore, find_first_damage, open_store, show_url
from labos.telemetry.otlp import check_receiver

Nodes = Literal["processes", "none"]


CHECKED_AT_ONCE = 50
"""The number of records that the background check reads without a pause: less than a millisecond."""

_log = structlog.get_logger(__name__)


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
    """Run a lab as long as the block lasts; watch ``kernel.failed`` during this time. A standby passes its
    ``follower`` with the state that it has read from the log.

    At the end, nodes complete their actions (within ``grace_s``), decided events are written, and a snapshot
    is stored. Raises Refused while another kernel runs this lab, or if its log is lost and its nodes'
    journals are there, BusError or BadInput for a port in use, SpecError for the contacts file, StoreError,
    LogTooNew.
    """
    expect_tls(settings)
    if settings.trace_receiver:
        check_receiver(settings.trace_receiver)
    plan_with = make_searching_scheduler if settings.searches_order else Scheduler
    simulated = _is_simulated(settings)
    contacts = find_contacts(settings)
    async with AsyncExitStack() as stack:
        with _make_lab_folder(settings.home):  # if the lab cannot be opened, nothing is left behind
            store = open_store(settings.database, home=settings.home)
            stack.callback(store.close)
            refuse_lost_log(store, settings.journals, show_url(settings.database))
            known, ended = store.known_position, store.head().position
            with _make_lab_folder(settings.worlds if simulated else settings.home):
                kernel, writer = await _open_kernel(settings, store, follower, plan_with)
        stack.push_async_callback(kernel.close)
        lab = LabRuntime(settings, kernel, store, simulated=simulated)
        stack.callback(lab.close_worlds)
        if simulated:
            kernel.listeners.append(SimulatedHands(lab.world, store, kernel.state))
        await add_first_user(settings, kernel)
        expect_users(settings, kernel)
        lab.metrics = LabMetrics(lab, writer)
        lab.metrics.traces = await stack.enter_async_context(send_traces(settings, kernel))
        stack.push_async_callback(lab.metrics.unattended.close)
        lab.blobs.tidy()
        _check_pace(settings, kernel)
        if 0 < ended < known:  # a new lab in an old folder has lost nothing
            kernel.submit(ReportShorterLog(known, "the note in the lab's folder", ended), "labos")
        # Before anything can start: the journals may have actions that the log does not have.
        for module, found, beyond in find_unlogged(store, settings.journals):
            kernel.submit(HearJournal(module, tuple(found), beyond), str(module))
        # The next start does not ask about the same loss again.
        kernel.listeners.append(OnEvents((BenchCompared,), lambda _: store.accept_end()))
        await kernel.begin_planning()
        notifier = await stack.enter_async_context(run_notifier(settings, contacts, kernel))
        modules = [*kernel.state.modules.by_name, *(m.name for c in workcells for m in c.workcell.modules)]
        security = await secure_bus(settings, lab, modules if nodes == "processes" else [])
        await open_lab_bus(
            settings, lab, stack, security, math.inf if follower is not None else BUS_PATIENCE_S
        )
        lab.service = make_service(lab, settings)
        http_port = choose_port(settings, settings.http_port, last_ports(settings.home).http)
        lab.gate = stack.enter_context(
            open_gate(
                settings,
                settings.database,
                kernel,
                lab.metrics.all.signing,
                key=lay_home_key(settings, stack),
            )
        )
        await give_first_password(settings, lab.gate.accounts)
        lab.service.marks = follow_marks(store, kernel, stack)
        lab.http = HttpServer(lab.service, lab.gate, describe_listening(settings, http_port))
        await lab.http.start()
        stack.push_async_callback(lab.http.close)
        await stack.enter_async_context(serve_api_processes(settings, lab))
        feeder = Feeder(kernel, CampaignRows(lab.service).propose)
        await feeder.start()
        stack.push_async_callback(feeder.close)
        watching = asyncio.get_running_loop().create_task(lab.service.miss_silent())
        stack.callback(watching.cancel)
        for cell in workcells:
            await lab.apply(cell, declare=declare)
        announce(settings.home, _make_info(settings, lab))
        stack.callback(withdraw, settings.home)
        if nodes == "processes":
            lab.start_nodes(detach=detach)
        lab.log_check = _check_log(settings, kernel)
        lab.log_check.start()
        lab.metrics.unattended.start()
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
                await lab.registry.wait_until_nodes_left(list(lab.supervised.nodes))
                lab.cut_short = _cut_short(kernel, killed)


def _check_log(settings: Settings, kernel: Kernel) -> LogCheck:
    """Checks the whole log in the background. After a damage is found, no action starts any more, because the
    lab's state may be wrong. A person decides how to continue."""

    def check(show_progress: Callable[[int, int], None]) -> Damage | None:
        reader = open_store(settings.database, create=False, read_only=True)
        try:
            return find_first_damage(reader, show_progress, every=CHECKED_AT_ONCE)
        finally:
            reader.close()

    def stop_starts(position: int, reason: str) -> None:
        why = f"The log is damaged at position {position}: {reason}. See `labos verify`."
        try:
            kernel.submit(PauseStarts(WHOLE_LAB, "labos", why), "labos")
        except StoreError as error:  # without its log it starts nothing either; the next start checks again
            _log.error("starts_not_paused", why=str(error))

    return LogCheck(check, stop_starts)


def _cut_short(kernel: Kernel, killed: Sequence[str]) -> list[str]:
    """The actions whose nodes were killed before the actions had ended."""
    try:
        open_ = list(kernel.state.actions.open.values())
    except StoreError:
        return []  # the next reader of the log finds them
    cut = [action for action in open_ if action.module in killed and action.status != ActionStatus.UNKNOWN]
    return [f"{local(action.module)}.{action.name} of {action.run}" for action in cut]


@contextmanager
def _make_lab_folder(path: Path) -> Iterator[None]:
    """Make a folder. If the block fails, for example because another kernel runs the lab, new parts of it are
    removed."""
    new = make_folder(path)[::-1]
    try:
        yield
    except BaseException:
        for folder in new:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
        raise


def _is_fenced(kernel: Kernel) -> bool:
    """Whether another kernel has taken over: the nodes belong to it now."""
    return kernel.failed.done() and isinstance(kernel.failed.result(), Fenced)


async def _open_kernel(
    settings: Settings,
    store: SqlEventStore,
    follower: Follower | None,
    plan_with: Callable[[], Scheduler],
) -> tuple[Kernel, ThreadWriter]:
    owner = f"pid {os.getpid()} on {socket.gethostname()}"
    after, within_s = settings.failures_borne
    chosen = make_from(
        KernelSettings,
        settings,
        pace=settings.speed or 1.0,
        owner=owner,
        quarantine_after=after,
        quarantine_within_s=within_s,
    )
    writer = ThreadWriter(store, silence_s=settings.silence_s)
    kernel = Kernel(writer, SystemClock(), Uuid7Ids(), chosen, plan_with)
    try:
        await kernel.open(follower, plan=False)
    except BaseException:
        await kernel.close()
        raise
    return kernel, writer


def _is_simulated(settings: Settings) -> bool:
    """Whether the lab is simulated: as requested, otherwise as before. Raises BadInput if a lab was of the
    other kind."""
    was = was_simulated(settings)
    wanted = bool(was) if settings.simulate is None else settings.simulate
    if was is not None and wanted != was:
        kinds = ("real", "simulated")
        raise BadInput(
            f"The lab in {settings.home} is {kinds[was]}; it cannot continue as a {kinds[wanted]} one.",
            remedy="Its log would not match the other bench. Use another --home.",
        )
    return wanted


def _check_pace(settings: Settings, kernel: Kernel) -> None:
    pace = kernel.state.lab.pace
    if settings.speed is not None and settings.speed != pace:
        raise BadInput(
            f"This lab runs at speed {pace:g} since it was created, not at {settings.speed:g}.",
            remedy="Leave --speed out, or use another --home.",
        )


def _make_info(settings: Settings, lab: LabRuntime) -> KernelInfo:
    own_bus = 0 if settings.bus else int(lab.bus_endpoint.rpartition(":")[2])
    remember_ports(settings.home, Ports(lab.http.port, own_bus))
    return KernelInfo(
        pid=os.getpid(),
        url=lab.http.url,
        bus=lab.bus_endpoint,
        lab=lab.kernel.lab,
        database=settings.database,
        simulated=lab.simulated,
        speed=lab.kernel.state.lab.pace,
        blobs=str(settings.blobs),
        certificate=str(Path(settings.tls_certificate).absolute()) if settings.tls_certificate else "",
        searches_order=settings.searches_order,
    )
