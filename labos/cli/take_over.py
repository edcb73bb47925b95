"""``labos take-over``: a standby takes over the lab; runs continue."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labos.cli._options import folder_home_option, json_option
from labos.cli._out import report_done
from labos.errors import NotFound, Refused, SystemFailed
from labos.settings import Settings, find_kernel

if TYPE_CHECKING:
    from labos.store import SqlEventStore

POLL_S = 0.02


@click.command("take-over", short_help="Let a standby take over while runs continue.")
@click.option(
    "--timeout",
    "wait_s",
    type=click.FloatRange(min=1.0),
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="How long to wait until the standby has taken over.",
)
@folder_home_option
@json_option
def command(home: str | None, wait_s: float) -> None:
    """Stop the kernel on this computer, and let its standby take over the lab at once. Runs continue and
    instruments are not disturbed. No action is started for one or two seconds. Run this command on the
    kernel's computer, as the user that runs the kernel.

    Use it to upgrade a lab without a stop: start the newer version as the standby, let it take over, and
    then do the same on the other computer (docs/three-hosts.md). The command is refused if there is no
    standby, or if this kernel has started nodes that would end with it (`labos up` without --no-nodes and
    --detach-nodes).

    \b
    labos take-over
    """
    from labos.store import open_store

    settings = Settings.make(home)
    running = find_kernel(settings.home)
    if running is None:
        raise NotFound(
            f"No kernel runs in {settings.home}.",
            remedy="Run this command where the kernel runs, or give its --home.",
        )
    number = getattr(signal, "SIGUSR1", None)
    if number is None or sys.platform == "win32":
        raise Refused(
            "A kernel on Windows cannot hand over its lab to a standby.",
            remedy="Stop it, and start `labos up` on the other computer.",
        )
    expect_to_listen(running.pid, number)
    with closing(open_store(running.database, create=False, read_only=True, home=settings.home)) as store:
        standing_by = store.standbys()
        if not standing_by:
            raise Refused(
                "This lab has no standby: it would stop.",
                remedy="Start a standby (`labos up --standby`), and wait until it reports that it stands by.",
            )
        epoch = store.head().epoch
        try:
            os.kill(running.pid, number)
        except OSError as error:
            raise Refused(
                f"The kernel (process {running.pid}) cannot be notified: {error.strerror}.",
                remedy="Run this command as the user that runs the kernel: sudo -u labos.",
            ) from None
        pause_s = _wait(store, epoch, wait_s)
        owner, epoch = store.find_holder().owner, store.head().epoch
    facts = {"kernel": owner, "epoch": epoch, "without_kernel_s": round(pause_s, 3), "stood_by": standing_by}
    message = f"The kernel {owner} has taken over (epoch {epoch}). There was none for {pause_s:.1f} s."
    report_done(message, facts)


def expect_to_listen(pid: int, number: int) -> None:
    """Check that a process listens to a signal: otherwise the signal would end it at once. Raises Refused if
    the system reports that it does not listen."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return  # not Linux, or no permission: nothing is known
    caught = next((line for line in status.splitlines() if line.startswith("SigCgt:")), "")
    if caught and not int(caught.split()[1], 16) & (1 << (number - 1)):
        raise Refused(
            f"The kernel (process {pid}) cannot hand over its lab: it has an earlier version, or is still "
            "starting. It was not changed.",
            remedy="Wait until it reports that its lab runs. If it has an earlier version, stop it (Ctrl-C): "
            "the standby takes over when it has ended.",
        )


def _wait(store: SqlEventStore, epoch: int, patience_s: float) -> float:
    """Wait for a kernel of a later epoch; returns how long there was none. Raises SystemFailed."""
    left_at = 0.0
    give_up = time.monotonic() + patience_s
    while time.monotonic() < give_up:
        if store.head().epoch > epoch:
            return time.monotonic() - left_at if left_at else 0.0
        if not left_at and store.find_holder().lease_left_s <= 0:
            left_at = time.monotonic()
        time.sleep(POLL_S)
    if left_at:
        raise SystemFailed(
            f"The kernel has stopped, and no standby has taken over for {patience_s:g} s.",
            remedy="Read the log of the standby, then start `labos up` on one of the computers.",
        )
    raise SystemFailed(
        f"The kernel has not handed over its lab within {patience_s:g} s: it continues.",
        remedy="See its log for the reason. A kernel does not hand over if nodes would end with "
        "it: start it with "
        "--detach-nodes, or with --no-nodes and separate nodes.",
    )
