"""An API process: it follows the log, and sends its users' requests to the kernel."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec

from labos.bootstrap._bus import BUS_PATIENCE_S, join_bus
from labos.bootstrap._desk import read_api_key
from labos.bootstrap._drivers import load_drivers
from labos.bootstrap._gate import (
    describe_listening,
    end_streams,
    expect_tls,
    expect_users,
    follow_marks,
    make_service,
    open_gate,
)
from labos.bootstrap._secure import Guard
from labos.clock import SystemClock, Uuid7Ids
from labos.core.canonical import digest
from labos.core.ids import ModuleName
from labos.core.model import Description
from labos.errors import BadInput, NotFound
from labos.http.letters import Letters
from labos.http.link import KernelLink
from labos.http.server import HttpServer
from labos.pki import PROCESS_NAME, PartyIdentity
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.ports import BlobStore, Bus
from labos.runtime.followed import FollowedKernel, SendOn
from labos.runtime.log_check import LogCheck
from labos.runtime.registry import Registry
from labos.settings import Settings, is_alive, last_kernel
from labos.store import SqlEventStore, is_replica, open_blobs, open_store, show_url
from labos.telemetry.api import ApiMetrics


class ApiSettings(msgspec.Struct, frozen=True):
    """The settings of an API process, besides those of the lab: its ``name``, unique in this lab, and the
    database with the ``accounts`` (empty: the database of the log)."""

    lab: Settings
    name: str = "api"
    accounts: str = ""


class ApiRuntime:
    """A running API process with the parts that its operations use. Made by ``open_api``."""

    supervised = None
    log_check: LogCheck | None = None
    http: HttpServer
    link: KernelLink

    def __init__(self, settings: ApiSettings, kernel: FollowedKernel, store: SqlEventStore) -> None:
        self.settings, self.kernel, self.store = settings, kernel, store
        self.clock = kernel.clock
        here = last_kernel(settings.lab.home) is not None
        self.blobs: BlobStore = LookedAtBlobs(open_blobs(settings.lab.blobs), are_all_here=here)
        drivers = load_drivers()
        self.descriptions: Mapping[str, Description] = drivers.make_descriptions()
        self.broken_drivers: Mapping[str, str] = drivers.broken
        self.counts = ApiMetrics()

    @property
    def simulated(self) -> bool:
        return self.link.notes.simulated

    @property
    def bus(self) -> Bus:
        """Only the kernel's process sends requests to nodes."""
        raise SendOn

    @property
    def registry(self) -> Registry:
        raise SendOn

    def follow_workcells(self, changed: Sequence[ModuleName] = ()) -> None:
        raise SendOn

    @property
    def metrics(self) -> ApiRuntime:
        return self

    def text(self) -> str:
        """All metrics of this process, in Prometheus' text format."""
        state, work = self.kernel.state, self.link.work
        found = self.counts
        found.info.set(1, (state.lab.id, state.lab.name, self.settings.name))
        found.take(
            position=state.position,
            recorded_at=state.recorded_at / 1e9,
            kernel_there=self.link.is_there,
            kernel_s=work.kernel_s,
        )
        answered = {"api": work.here, "kernel": work.by_kernel, "nobody": work.away}
        found.requests.replace({(by,): count for by, count in answered.items()})
        return found.text()

    def targets(self, host: str) -> list[dict[str, Any]]:
        """The addresses of this process's metrics; the kernel knows those of all others."""
        labels = {"lab": self.kernel.state.lab.name, "process": "api", "api": self.settings.name}
        return [{"targets": [host], "labels": labels}]


class LookedAtBlobs:
    """The lab's blobs, only for reading: the kernel's process stores the blobs of requests. ``are_all_here``:
    a blob that is not found does not exist."""

    def __init__(self, blobs: BlobStore, *, are_all_here: bool) -> None:
        self._blobs, self._are_all_here = blobs, are_all_here

    def get(self, digest: str) -> bytes:
        """Raises the errors of the lab's blobs, or SendOn."""
        try:
            return self._blobs.get(digest)
        except NotFound:
            if self._are_all_here:
                raise
        raise SendOn

    def put(self, data: bytes) -> str:
        return digest(data)


@asynccontextmanager
async def open_api(api_settings: ApiSettings) -> AsyncIterator[ApiRuntime]:
    """Serve the HTTP interface of a lab as long as the block lasts. Raises BadInput, NotFound, Refused,
    BusError, StoreError."""
    if not PROCESS_NAME.fullmatch(api_settings.name):
        raise BadInput(
            f"{api_settings.name!r} cannot be the name of an API process.",
            remedy="Take a-z, 0-9 and -, as in api-2.",
        )
    settings, accounts = _find_bus(api_settings.lab), api_settings.accounts or api_settings.lab.database
    expect_tls(settings)
    if await asyncio.to_thread(is_replica, accounts):
        raise BadInput(
            f"{show_url(accounts)} is a read-only copy of another database, but sessions have to be written.",
            remedy="Name the database that it copies with --accounts (LABOS_ACCOUNTS_URL): it is used only "
            "for tokens and sessions.",
        )
    async with AsyncExitStack() as stack:
        store = await asyncio.to_thread(
            open_store, settings.database, create=False, read_only=True, home=settings.home
        )
        stack.callback(store.close)
        plan_with = make_searching_scheduler if settings.searches_order else Scheduler
        kernel = FollowedKernel(store, SystemClock(), Uuid7Ids(), plan_with)
        await kernel.open()
        if not kernel.state.lab.id:
            raise BadInput(
                f"There is no lab yet in {show_url(settings.database)}.", remedy="Start its kernel: labos up"
            )
        expect_users(settings, kernel)
        api = ApiRuntime(msgspec.structs.replace(api_settings, lab=settings), kernel, store)
        await _link(api, stack)
        service = make_service(api, settings)
        service.link = api.link
        service.marks = follow_marks(store, kernel, stack)
        gate = stack.enter_context(open_gate(settings, accounts, kernel, api.counts.signing))
        api.http = HttpServer(service, gate, describe_listening(settings, settings.http_port or 0))
        kernel.follow()
        stack.push_async_callback(kernel.close)
        api.link.address = f"{settings.host}:{api.http.port}"
        await api.link.start()
        stack.push_async_callback(api.link.close)
        await api.http.start()
        stack.push_async_callback(api.http.close)
        ending = asyncio.get_running_loop().create_task(end_streams(api.http.app.state.api))
        stack.callback(ending.cancel)
        yield api


def _find_bus(settings: Settings) -> Settings:
    """The settings with the bus of the kernel that runs in the lab's folder, unless they name a bus. Raises
    NotFound."""
    last = last_kernel(settings.home)
    if settings.bus:
        return settings
    if last is None or not is_alive(last.pid):
        raise NotFound(
            f"No kernel runs in {settings.home}, and no bus was given.",
            remedy="Start the lab (labos up), or give its bus: --bus tcp/HOST:7447.",
        )
    secure = last.bus.startswith("tls/") if settings.secure is None else settings.secure
    return msgspec.structs.replace(settings, bus=(last.bus,), secure=secure)


async def _link(api: ApiRuntime, stack: AsyncExitStack) -> None:
    """Join the bus, and register at the kernel."""
    settings, kernel = api.settings.lab, api.kernel
    guard = None
    if settings.is_secure:
        who = PartyIdentity("api", api.settings.name, kernel.lab)
        own: Path | None = settings.certificate
        guard = Guard(who, settings, runs_bus=False, own=own)
    security = await asyncio.to_thread(guard.prepare) if guard is not None else None
    bus = await join_bus(settings.bus, BUS_PATIENCE_S, security)
    stack.push_async_callback(bus.close)
    if guard is not None:
        await guard.watch(bus)
        stack.push_async_callback(guard.close)
    key = b"" if guard is not None else read_api_key(settings)
    api.link = KernelLink(kernel, bus, Letters(key, kernel.clock), api.settings.name)
