"""The bus of a kernel's process: its own bus or a separate one, with or without certificates."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import AsyncExitStack

import structlog

from labos.bootstrap._runtime import LabRuntime
from labos.bootstrap._secure import Guard
from labos.bus import SCHEME, Security, ZenohBus, open_bus
from labos.errors import BusError
from labos.node.protocol import Keys
from labos.pki import PartyIdentity
from labos.runtime.announcer import Announcer
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.files import FileDesk
from labos.runtime.reconcile import Reconciler
from labos.runtime.registry import Registry
from labos.runtime.verify import Verifier
from labos.settings import Settings, free_port, is_free, last_ports

_log = structlog.get_logger(__name__)


BUS_PATIENCE_S = 20.0
"""How long a starting kernel waits for a separate bus. A kernel that has taken over from another waits
without limit: it has the lab, and no other kernel would take it back."""


BUS_POLL_S = 0.2


async def secure_bus(settings: Settings, lab: LabRuntime, modules: Sequence[str]) -> Security | None:
    """The certificates of a secure bus; ``modules`` are those whose nodes run here. Raises NotFound, Refused,
    BadInput."""
    if not settings.is_secure:
        return None
    lab.guard = Guard(
        PartyIdentity("kernel", lab=lab.kernel.lab),
        settings,
        runs_bus=not settings.bus,
        own=settings.certificate,
        modules=lambda: list(lab.supervised.nodes) if lab.supervised is not None else [],
        note_unheard=lab.note_unheard,
    )
    return await asyncio.to_thread(lab.guard.prepare, modules)


async def join_bus(endpoints: Sequence[str], patience_s: float, security: Security | None) -> ZenohBus:
    """The separate bus, as soon as it answers: after a power cut it may be the last to start. Raises BusError
    if it does not answer within ``patience_s``."""
    now, warned = asyncio.get_running_loop().time, False
    give_up = now() + patience_s
    while True:
        try:
            return await open_bus(mode="client", connect=endpoints, security=security)
        except BusError as error:
            if now() >= give_up:
                raise
            if not warned:
                _log.warning("waiting_for_the_bus", why=error.message)
            warned = True
        await asyncio.sleep(BUS_POLL_S)


async def open_lab_bus(
    settings: Settings,
    lab: LabRuntime,
    stack: AsyncExitStack,
    security: Security | None,
    patience_s: float,
) -> None:
    """Open the router to which all others connect, unless there is a separate one; and declare the kernel's
    keys."""
    if settings.bus:
        lab.bus_endpoint = settings.bus[0]
        lab.bus = await join_bus(settings.bus, patience_s, security)
    else:
        port = choose_port(settings, settings.bus_port, last_ports(settings.home).bus) or free_port(
            settings.host
        )
        scheme = SCHEME if security is not None else "tcp/"
        listening = f"{scheme}{settings.host}:{port}"
        # A certificate is for certain addresses, never for all.
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
    lab.announcer = Announcer(lab.kernel, lab.bus)
    watchers = (Reconciler(lab.kernel, lab.bus), Verifier(lab.kernel, lab.bus))
    for part in (lab.dispatcher, lab.announcer, lab.registry, *watchers):
        await part.start()
        stack.push_async_callback(part.close)
    await lab.bus.serve(keys.setup, lab.on_setup)
    await lab.bus.serve_all(keys.all_setups, lab.on_setup_of)
    await lab.bus.serve(keys.files, FileDesk(lab.blobs, settings.arriving).on_request)
    await lab.bus.declare_alive(keys.kernel)


def choose_port(settings: Settings, wanted: int | None, last: int) -> int:
    """The requested port; otherwise the last one if it is free; otherwise 0 for any port."""
    if wanted is not None:
        return wanted
    return last if last and is_free(last, settings.host) else 0
