"""Finds out that a client is connected to a router that was closed, and connects it to the bus again.

A router that runs in this project's processes opens its session again when certificates change. A client that
connects at that moment can be accepted by the session that is being closed. Zenoh then keeps this connection
for as long as the process lives, and the client hears nobody. The router answers queries for living keys all
the same, but its own keys are gone: so a router of a bus shows a key while it is open, and clients query it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import structlog

CHECK_S = 2.0
"""How often a client checks that its router is open (seconds)."""

MISSED = 3
"""After so many checks in turn without the router's key, the client connects again. If that does not help, it
waits for twice as many, up to ``MOST_MISSED``: perhaps its certificate is not admitted."""

MOST_MISSED = 30

_log = structlog.get_logger(__name__)


class ConnectionCheck:
    """Decides when a client has to connect again."""

    def __init__(self) -> None:
        self._missed = 0
        self._limit = MISSED

    def note_seen(self) -> None:
        """The router's key was seen."""
        self._missed, self._limit = 0, MISSED

    def note_uncertain(self) -> None:
        """There is no router, or it did not answer: Zenoh itself connects again."""
        self._missed = 0

    def note_missed(self) -> bool:
        """The router answers, but does not show its key. Returns whether to connect again."""
        self._missed += 1
        if self._missed < self._limit:
            return False
        self._missed, self._limit = 0, min(2 * self._limit, MOST_MISSED)
        return True


async def keep_connected(
    is_router_open: Callable[[], Awaitable[bool | None]],
    reopen: Callable[[], Awaitable[None]],
    check_s: float,
) -> None:
    """Check the connection for as long as the session is open. ``is_router_open`` returns None if that is not
    known. An unexpected error does not end the checks."""
    check, logged, failed = ConnectionCheck(), False, False
    while True:
        await asyncio.sleep(check_s)
        try:
            found = await is_router_open()
            if found is None:
                check.note_uncertain()
            elif found:
                check.note_seen()
                logged = False
            elif check.note_missed():
                if not logged:
                    why = "the bus at the other end was closed, or it does not accept this certificate (yet)"
                    _log.warning("bus_connects_again", why=why)
                logged = True
                await reopen()
            failed = False
        except Exception:
            if not failed:  # once, not at every check
                _log.exception("bus_check_failed")
            failed = True
