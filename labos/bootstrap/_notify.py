"""Notifications: in the kernel's process, or in a separate process that continues when the kernel ends."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager, contextmanager

import structlog

from labos.clock import Clock
from labos.core.registry import TYPES as EVENTS
from labos.errors import LabosError
from labos.lockfile import FileLock
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import OnEvents
from labos.services.notify import TYPES, Book, Notifier, Outbox, load_contacts
from labos.settings import CONTACTS, Settings, was_simulated
from labos.store import open_store

_log = structlog.get_logger(__name__)


def find_contacts(settings: Settings) -> Book | None:
    """The contacts of this lab; None if it has none. Raises SpecError, SpecErrors."""
    if not os.environ.get(CONTACTS) and not settings.contacts.is_file():
        return None
    return load_contacts(settings.contacts)


@asynccontextmanager
async def run_notifier(
    settings: Settings, book: Book | None, kernel: Kernel
) -> AsyncIterator[Notifier | None]:
    """Notify people as long as the block lasts. A failure here does not affect the lab."""
    if book is None:
        yield None
        return
    with ExitStack() as stack:
        try:
            notifier = stack.enter_context(make_notifier(settings, book, kernel.clock))
        except (LabosError, OSError) as error:
            _log.error("nobody_is_notified", why=str(error))
            notifier = None
        if notifier is None:
            yield None
            return
        kernel.failed.add_done_callback(lambda failed: notifier.on_kernel_stopped(str(failed.result())))
        bell = OnEvents(tuple(EVENTS[name] for name in TYPES), lambda _: notifier.wake())
        kernel.listeners.append(bell)
        notifier.start()
        try:
            yield notifier
        finally:
            kernel.listeners.remove(bell)
            await asyncio.to_thread(notifier.close)


@contextmanager
def make_notifier(settings: Settings, book: Book, clock: Clock) -> Iterator[Notifier | None]:
    """A notifier that has not been started; None while another process notifies people."""
    lock = FileLock(settings.notifications.with_suffix(".lock"))
    if not lock.acquire(f"pid {os.getpid()}"):
        _log.info("another_process_notifies", holder=lock.note())
        yield None
        return
    with ExitStack() as stack:
        stack.callback(lock.release)
        store = open_store(settings.database, create=False, read_only=True, home=settings.home)
        stack.callback(store.close)
        outbox = Outbox(settings.notifications)
        outbox.forget(clock.now_ns())
        notifier = Notifier(
            store, outbox, book, clock, simulated=bool(was_simulated(settings)), hang_up=store.hang_up
        )
        yield notifier
        if not notifier.busy:
            outbox.close()
