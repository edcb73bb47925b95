"""What time it is in a lab, by whether a kernel lives there."""

from __future__ import annotations

import click

from labos.cli._query import now_ns
from labos.ports import Head
from labos.services.times import show_time
from labos.store import lease_holder


def lab_now(url: str, head: Head) -> int:
    """The present (UTC ns) where a kernel lives; else the last event, for nothing went on since."""
    return max(now_ns(), head.recorded_at) if lease_holder(url) else head.recorded_at


def say_if_dead(url: str, head: Head) -> None:
    """Say on stderr, where no kernel runs the lab, how old what is shown is."""
    if head.position and not lease_holder(url):
        when = show_time(head.recorded_at)
        click.echo(f"labos: No kernel runs this lab. Its last event was at {when}; last known:", err=True)
