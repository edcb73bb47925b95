"""What time it is in a lab, by whether a kernel lives there."""

from __future__ import annotations

from labos.cli._query import now_ns
from labos.ports import Head
from labos.store import lease_holder


def lab_now(url: str, head: Head) -> int:
    """The present (UTC ns) where a kernel lives; else the last event, for nothing went on since."""
    return max(now_ns(), head.recorded_at) if lease_holder(url) else head.recorded_at
