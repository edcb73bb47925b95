"""A standby: follows the log of a lab that another kernel runs, until that one is gone."""

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
"""How often a standby reads what is new, and looks whether the kernel is still there."""

SURE_S = 3.0
"""A kernel whose lock is gone while its lease runs is given so long to take it again, as it does after the
database has dropped its session; it tries every 2 s."""

SETTLED_S = 12.0
"""After the database was away a kernel is given so long to find it again: it looks every 5 s at least."""

_log = structlog.get_logger(__name__)


class Standby:
    """Follows one lab. Made by ``open_standby``."""

    def __init__(self, store: SqlEventStore) -> None:
        self._store = store
        self.follower = Follower(store)
        self._unlocked_since: float | None = None
        self._away_until = float("-inf")
        self._ready = False
        self._name = f"{VERSION} on {gethostname()}"[:40]  # the server keeps 63 bytes with what comes before

    async def wait(self, end: asyncio.Event, ready: Callable[[], None]) -> str:
        """Follow the log until its kernel is gone; returns who that was, empty if ``end`` came before. A
        kernel that gave its lab back in order is not replaced: somebody wanted it so. ``ready`` is
        called as soon as the log has been read. Raises LogTooNew, LogDamaged."""
        await asyncio.to_thread(load_drivers)  # what takes long at a start is done before it is needed
        ending = asyncio.get_running_loop().create_task(self._hang_up_at(end))
        try:
            return await self._follow(end, ready)
        finally:
            ending.cancel()

    async def _hang_up_at(self, end: asyncio.Event) -> None:
        """It can be ended without waiting for a database that is frozen."""
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
                if self._ready and now() - asked > SURE_S:  # it stood still, and for its kernel too
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
    """A standby for the lab in a database. Raises BadInput where none is possible, StoreUnavailable."""
    if find_database_file(settings.database) is not None:
        raise BadInput(
            "A standby needs a PostgreSQL database: the lock of a kernel on SQLite goes with its process.",
            remedy="Let the system start `labos up` again when it dies, or move the log (labos backup, "
            "labos restore).",
        )
    if not settings.bus:
        raise BadInput(
            "A standby needs a bus that outlives the kernel.",
            remedy="Run one with `labos bus`, and name it to both kernels: --bus tcp/HOST:7447.",
        )
    if settings.is_secure and settings.certificate is None and not Authority(settings.pki).exists:
        raise BadInput(
            f"The bus is a secure one, and there is no certificate, and no authority in {settings.pki}.",
            remedy="Copy the kernel's folder here from where the authority is, and name it with --cert.",
        )
    store = await asyncio.to_thread(
        open_store, settings.database, create=False, read_only=True, home=settings.home
    )
    try:
        yield Standby(store)
    finally:
        store.close()
