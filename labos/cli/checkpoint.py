"""``labos checkpoint``: signs the log's end, and stores it elsewhere."""

from __future__ import annotations

import threading

import click

from labos.cli._lab import end_in_order
from labos.cli._out import show_json, show_lines, wants_json
from labos.cli._query import Where, folder_and_json, now_ns, open_database
from labos.errors import StoreUnavailable
from labos.services.times import show_time
from labos.services.trust.keys import read_given_keys
from labos.services.trust.publish import PublishResult, Targets, publish
from labos.services.trust.tree import read_tree

EVERY = 1000
POLL_S = 2.0


@click.command("checkpoint", short_help="Sign the present end of the log, and store it elsewhere.")
@click.option(
    "--to",
    "places",
    multiple=True,
    metavar="FOLDER|URL",
    help="Store it there as well: a folder, or a URL that accepts HTTP PUT. May be repeated.",
)
@click.option(
    "--witness",
    "witnesses",
    multiple=True,
    metavar="URL",
    help="Let this witness cosign it (`labos witness`, or another one of C2SP tlog-witness).",
)
@click.option(
    "--witness-key",
    "witness_keys",
    multiple=True,
    metavar="KEY|FILE",
    help="Accept only cosignatures that this public key verifies.",
)
@click.option("--timestamp", "stamp", metavar="URL", default="", help="An RFC 3161 time stamp authority.")
@click.option(
    "-f", "--follow", is_flag=True, help="Continue until Ctrl-C, with a new checkpoint after --every events."
)
@click.option(
    "--every",
    type=click.IntRange(min=1),
    default=EVERY,
    show_default=True,
    metavar="EVENTS",
    help="With --follow: the number of new events until the next checkpoint.",
)
@click.option(
    "--at-least-every",
    "seconds",
    type=click.FloatRange(min=1.0),
    default=3600.0,
    show_default=True,
    metavar="SECONDS",
    help="With --follow: write a checkpoint after this time at the latest, if there is a new event.",
)
@folder_and_json
def command(
    where: Where,
    places: tuple[str, ...],
    witnesses: tuple[str, ...],
    witness_keys: tuple[str, ...],
    stamp: str,
    follow: bool,
    every: int,
    seconds: float,
) -> None:
    """Sign the root of the Merkle tree over the log, and store this checkpoint. Choose a place without write
    access for users of the database. The lab may run meanwhile and is not slowed down. LabOS does not sign
    a log that was rewritten or cut since the last checkpoint. Exit code 1 if a place or a witness did not
    accept the checkpoint.

    \b
    labos key create
    labos checkpoint --to /safe/lab                       now
    labos checkpoint --to https://safe.example.org/lab --follow   continuously, until Ctrl-C
    labos checkpoint --witness https://lab2.example.org   another lab cosigns

    Each checkpoint is a signed note in the format of C2SP tlog-checkpoint. A copy stays in checkpoints/ of
    the lab's folder.
    """
    targets = Targets(places, witnesses, tuple(read_given_keys(witness_keys)), stamp)
    if follow:
        _follow(where, targets, every, seconds)
        return
    with open_database(where) as store:
        made = publish(store, where.home, targets)
    _report_checkpoint(made)
    if made.faults:
        click.get_current_context().exit(1)


def _follow(where: Where, targets: Targets, every: int, seconds: float) -> None:
    """Until Ctrl-C. If the database is away, it waits; if the log was rewritten, it ends."""
    pause = threading.Event()
    last_ns = 0
    with end_in_order():
        try:
            while True:
                try:
                    with open_database(where) as store:
                        gained = store.head().position - read_tree(where.home).size
                        due = gained and now_ns() - last_ns >= seconds * 1e9
                        if gained < 0 or gained >= every or due:
                            made = publish(store, where.home, targets)
                            last_ns = now_ns()
                            _report_checkpoint(made)
                except StoreUnavailable as error:
                    click.echo(f"labos: {error}", err=True)
                pause.wait(POLL_S)
        except KeyboardInterrupt:
            pass


def _report_checkpoint(made: PublishResult) -> None:
    if wants_json():
        show_json(
            {
                "origin": made.head.origin,
                "size": made.head.size,
                "root": made.head.root.hex(),
                "signatures": [signature.name for signature in made.note.signatures],
                "time_stamp": made.stamped,
                "written": made.written,
                "faults": made.faults,
            }
        )
        return
    signed = ", ".join(signature.name for signature in made.note.signatures)
    click.echo(f"{show_time(now_ns())}: checkpoint of size {made.head.size}, signed by {signed}.")
    click.echo(f"Root {made.head.root.hex()}{', time-stamped' if made.stamped else ''}")
    show_lines(made.written, "Kept in ")
    show_lines(made.faults, "labos: ", err=True)
