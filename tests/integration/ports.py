"""Free ports for tests."""

from __future__ import annotations

import socket


def free_endpoint() -> str:
    """A TCP endpoint on this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
