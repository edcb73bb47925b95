"""TCP's own way of finding out that the computer at the other end is gone.

What is waited for on a silent connection may take an hour, and a computer that has lost its power says
nothing. Without these options a system asks after two hours, if at all. They say nothing of a program that
is alive and mute: its computer answers for it.
"""

from __future__ import annotations

import contextlib
import socket

PROBES = 4
"""How many questions in a row must go unanswered."""

Option = tuple[int, int, int]


def timings(limit_s: float) -> tuple[int, int, int]:
    """(seconds of silence before the first question, seconds between questions, how many) so that a dead
    computer is noticed after ``limit_s``, or after 5 s if that is more."""
    between = max(1, round(limit_s / (2 * PROBES)))
    return max(1, round(limit_s) - PROBES * between), between, PROBES


def keepalive(limit_s: float) -> list[Option]:
    """Options of a socket, as ``setsockopt`` takes them. What a system has no name for is left out: macOS
    calls the first time otherwise, old versions of Windows lack all three."""
    idle = getattr(socket, "TCP_KEEPIDLE", None) or getattr(socket, "TCP_KEEPALIVE", None)
    names = idle, getattr(socket, "TCP_KEEPINTVL", None), getattr(socket, "TCP_KEEPCNT", None)
    known = [
        (socket.IPPROTO_TCP, name, value)
        for name, value in zip(names, timings(limit_s), strict=True)
        if name is not None
    ]
    return [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1), *known]


def keep_alive(connection: socket.socket, limit_s: float) -> None:
    """Set them. A system that does not take one is left as it is."""
    for option in keepalive(limit_s):
        with contextlib.suppress(OSError):
            connection.setsockopt(*option)
