"""A standby: follows the log of a lab that another kernel runs, until that one is gone."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import structlog

from labos.bootstrap._drivers import load_drivers
from labos.errors import BadInput, StoreUnavailable
from labos.runtime.follower import Follower
from labos.settings import Settings
from labos.store import database_file, open_store

POLL_S = 0.5
"""How often a standby reads what is new, and looks whether the kernel is still there."""

_log = structlog.get_logger(__name__)


@asynccontextmanager
async def following(settings: Settings) -> AsyncIterator[Follower]:
    """The follower of the lab in a database. Raises BadInput where no standby is possible."""
    if database_file(settings.database) is not None:
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
    store = await asyncio.to_thread(open_store, settings.database, create=False, read_only=True)
    try:
        yield Follower(store)
    finally:
        store.close()


async def stand_by(follower: Follower, end: asyncio.Event) -> str:
    """Follow the log until its kernel is gone; returns who that was, empty if ``end`` came before. A kernel
    that gave its lab back in order is not replaced: somebody wanted it so. Raises LogTooNew, LogDamaged."""
    await asyncio.to_thread(load_drivers)  # what takes long at a start is done before it is needed
    while not end.is_set():
        try:
            await asyncio.to_thread(follower.catch_up)
            gone = await asyncio.to_thread(follower.store.abandoned_by)
            if gone and follower.state.position:
                _log.warning("kernel_gone", kernel=gone, position=follower.state.position)
                return gone
        except StoreUnavailable as error:
            _log.warning("log_not_read", why=str(error))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(end.wait(), POLL_S)
    return ""
