"""TCP keepalive: finds out that the computer at the other end is gone. An answer on a silent connection may
take an hour, and a computer without power sends nothing. Without these options, a system probes after two
hours, if at all. They do not detect a program that hangs, because its computer answers the probes.
"""

from __future__ import annotations

import contextlib
import socket

PROBES = 4
"""The number of unanswered probes in a row."""

Option = tuple[int, int, int]


def choose_timings(limit_s: float) -> tuple[int, int, int]:
    """(seconds of silence before the first probe, seconds between probes, number of probes), so that a dead
    computer is noticed after ``limit_s``, but not before 5 s."""
    between = max(1, round(limit_s / (2 * PROBES)))
    return max(1, round(limit_s) - PROBES * between), between, PROBES


def make_options(limit_s: float) -> list[Option]:
    """Socket options for ``setsockopt``. Options without a name in this system are left out: macOS has
    another name for the first, and old versions of Windows have none of the three."""
    idle = getattr(socket, "TCP_KEEPIDLE", None) or getattr(socket, "TCP_KEEPALIVE", None)
    names = idle, getattr(socket, "TCP_KEEPINTVL", None), getattr(socket, "TCP_KEEPCNT", None)
    known = [
        (socket.IPPROTO_TCP, name, value)
        for name, value in zip(names, choose_timings(limit_s), strict=True)
        if name is not None
    ]
    return [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1), *known]


def keep_alive(connection: socket.socket, limit_s: float) -> None:
    """Set the options. An option that the system refuses is not set."""
    for option in make_options(limit_s):
        with contextlib.suppress(OSError):
            connection.setsockopt(*option)
