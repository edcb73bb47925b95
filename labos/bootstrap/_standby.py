"""A standby: it follows the log of a lab that another kernel runs, until that kernel is gone."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from socket import gethostname

import structlog

from labos.bootstrap._drivers import load_drivers
from labos.errors import BadInput, StoreUnavailable
from labos.pki import Authority
from labos.runtime.follower import Follower
from labos.settings import Settings
from labos.store import Holder, SqlEventStore, find_database_file, open_store
from labos.version import VERSION

POLL_S = 0.5
"""How often a standby reads new events, and checks whether the kernel is still there (seconds)."""

SURE_S = 3.0
"""A kernel whose lock is gone while its lease is valid has this long to take the lock again (seconds). It
needs this after the database has dropped its session; it tries every 2 s."""

SETTLED_S = 12.0
"""After an outage of the database, a kernel has this long to find it again (seconds); it tries at least every
5 s."""

_log = structlog.get_logger(__name__)


class Standby:
    """Follows one lab. Made by ``open_standby``."""

    def __init__(self, store: SqlEventStore) -> None:
        self._store = store
        self.follower = Follower(store)
        self._unlocked_since: float | None = None
        self._away_until = float("-inf")
        self._ready = False
        # The server stores 63 bytes, including the part before.
        self._name = f"{VERSION} on {gethostname()}"[:40]

    async def wait(self, end: asyncio.Event, ready: Callable[[], None]) -> str:
        """Follow the log until its kernel is gone. Returns the name of that kernel; empty if ``end`` came
        before. A kernel that released its lab in an orderly way is not replaced, because this was intended.
        ``ready`` is called as soon as the log has been read. Raises LogTooNew, LogDamaged."""
        await asyncio.to_thread(load_drivers)  # slow parts of a start are done before they are needed
        ending = asyncio.get_running_loop().create_task(self._hang_up_at(end))
        try:
            return await self._follow(end, ready)
        finally:
            ending.cancel()

    async def _hang_up_at(self, end: asyncio.Event) -> None:
        """End the wait even if a call hangs in a frozen database."""
        await end.wait()
        self._store.hang_up()

    async def _follow(self, end: asyncio.Event, ready: Callable[[], None]) -> str:
        now = asyncio.get_running_loop().time
        while not end.is_set():
            asked = now()
            try:
                await asyncio.to_thread(self.follower.catch_up)
                await asyncio.to_thread(self._store.stand_by, self._name)
                found = await asyncio.to_thread(self._store.find_holder)
                if self._ready and now() - asked > SURE_S:  # the database stood still, for the kernel too
                    self._away_until, self._unlocked_since = now(), None
                if not self._ready:
                    self._ready = True
                    ready()
            except StoreUnavailable as error:
                _log.warning("log_not_read", why=str(error))
                self._away_until, self._unlocked_since = now(), None
            else:
                if self.follower.state.position and self._is_gone(found, now()):
                    _log.warning("kernel_gone", kernel=found.owner, position=self.follower.state.position)
                    await asyncio.to_thread(self._store.stand_down)
                    return found.owner
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(end.wait(), POLL_S)
        return ""

    def _is_gone(self, found: Holder, now: float) -> bool:
        if not found.owner or found.living:
            self._unlocked_since = None
            return False
        if self._unlocked_since is None:
            self._unlocked_since = now
        if now - self._away_until < SETTLED_S:
            return False
        return found.lease_left_s <= 0 or now - self._unlocked_since >= SURE_S


@asynccontextmanager
async def open_standby(settings: Settings) -> AsyncIterator[Standby]:
    """A standby for the lab in a database. Raises BadInput for a database that allows none,
    StoreUnavailable."""
    if find_database_file(settings.database) is not None:
        raise BadInput(
            "A standby needs a PostgreSQL database: on SQLite, the lock of a kernel ends with its process.",
            remedy="Let the operating system restart `labos up` when it dies, or move the log (labos "
            "backup, labos restore).",
        )
    if not settings.bus:
        raise BadInput(
            "A standby needs a bus that continues when the kernel dies.",
            remedy="Start one with `labos bus`, and give it to both kernels: --bus tcp/HOST:7447.",
        )
    if settings.is_secure and settings.certificate is None and not Authority(settings.pki).exists:
        raise BadInput(
            f"The bus is secure, but there is no certificate, and no authority in {settings.pki}.",
            remedy="Copy the kernel's folder here from the computer of the authority, and give it with "
            "--cert.",
        )
    store = await asyncio.to_thread(
        open_store, settings.database, create=False, read_only=True, home=settings.home
    )
    try:
        yield Standby(store)
    finally:
        store.close()
