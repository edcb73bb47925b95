"""``labos checkpoint``: the log's end, signed and kept elsewhere."""

from __future__ import annotations

import threading

import click

from labos.cli._out import show_json
from labos.cli._query import Where, json_option, log_options, now_ns, open_database
from labos.errors import StoreUnavailable
from labos.services.times import show_time
from labos.services.trust.keys import read_given_keys
from labos.services.trust.publish import PublishResult, Targets, publish
from labos.services.trust.tree import read_tree

EVERY = 1000
POLL_S = 2.0


@click.command("checkpoint", short_help="Sign the log's end, and keep it outside the database.")
@click.option(
    "--to",
    "places",
    multiple=True,
    metavar="FOLDER|URL",
    help="Keep it there as well: a folder, or a URL that takes HTTP PUT. May be repeated.",
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
    help="Accept only cosignatures that this public key checks.",
)
@click.option("--timestamp", "stamp", metavar="URL", default="", help="An RFC 3161 time stamp authority.")
@click.option("-f", "--follow", is_flag=True, help="Go on until Ctrl-C: one checkpoint every so many events.")
@click.option(
    "--every",
    type=click.IntRange(min=1),
    default=EVERY,
    show_default=True,
    metavar="EVENTS",
    help="With --follow: after so many new events.",
)
@click.option(
    "--at-least-every",
    "seconds",
    type=click.FloatRange(min=1.0),
    default=3600.0,
    show_default=True,
    metavar="SECONDS",
    help="With --follow: after this time, if there is any new event.",
)
@json_option
@log_options
def command(
    where: Where,
    places: tuple[str, ...],
    witnesses: tuple[str, ...],
    witness_keys: tuple[str, ...],
    stamp: str,
    follow: bool,
    every: int,
    seconds: float,
    as_json: bool,
) -> None:
    """Sign the root of the Merkle tree over the log, and bring it to where whoever can write to the database
    cannot change it. Reads the log by itself: the lab may run, and is not slowed. A log that was rewritten or
    cut since the last checkpoint is not signed. Exit code 1 if a place or a witness did not take it.

    \b
    labos key create
    labos checkpoint --to /safe/lab                       now
    labos checkpoint --to https://safe.example.org/lab --follow   from now on, in a process of its own
    labos checkpoint --witness https://lab2.example.org   another lab cosigns

    Each is a signed note in the form of C2SP tlog-checkpoint; a copy stays in checkpoints/ of the lab's
    folder.
    """
    targets = Targets(places, witnesses, tuple(read_given_keys(witness_keys)), stamp)
    if follow:
        _follow(where, targets, every, seconds, as_json)
        return
    with open_database(where) as store:
        made = publish(store, where.home, targets)
    _tell(made, as_json)
    if made.faults:
        click.get_current_context().exit(1)


def _follow(where: Where, targets: Targets, every: int, seconds: float, as_json: bool) -> None:
    """Until Ctrl-C. A database that is away is waited for; a log that was rewritten ends it."""
    from labos.cli._lab import orderly

    pause = threading.Event()
    last_ns = 0
    with orderly():
        try:
            while True:
                try:
                    with open_database(where) as store:
                        gained = store.head().position - read_tree(where.home).size
                        due = gained and now_ns() - last_ns >= seconds * 1e9
                        if gained < 0 or gained >= every or due:
                            made = publish(store, where.home, targets)
                            last_ns = now_ns()
                            _tell(made, as_json)
                except StoreUnavailable as error:
                    click.echo(f"labos: {error}", err=True)
                pause.wait(POLL_S)
        except KeyboardInterrupt:
            pass


def _tell(made: PublishResult, as_json: bool) -> None:
    if as_json:
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
    for place in made.written:
        click.echo(f"Kept in {place}")
    for fault in made.faults:
        click.echo(f"labos: {fault}", err=True)
