"""``labos sign``: an electronic signature under a run."""

from __future__ import annotations

from collections.abc import Sequence

import click
import msgspec

from labos.cli._complete import completes
from labos.cli._options import why_option
from labos.cli._out import show_json, tell
from labos.cli._query import Where, json_option, log_options, open_log
from labos.core.signatures import MEANINGS
from labos.errors import BadInput
from labos.services.signatures import Signature, signatures_under


@click.command("sign", short_help="Sign the record of a run, or show its signatures.")
@click.argument("run", shell_complete=completes("run"))
@click.option("--meaning", type=click.Choice(MEANINGS), help="What the signature means.")
@why_option("A comment, which stands in the log.")
@json_option
@log_options
def command(where: Where, run: str, meaning: str | None, why: str, as_json: bool) -> None:
    """Sign the record of RUN, which has ended. You are asked for your password again.

    The signature is an event: who, when, what it means, and the digest of all records of the run, so that it
    cannot be moved to another run. It is part of the run's bundle. Without --meaning, the signatures of RUN
    are shown. Without a terminal, the first line of standard input is the password.

    \b
    labos sign R7 --meaning reviewed --why "checked against the protocol"
    labos sign R7
    """
    from labos.cli._lab import need_lab_of
    from labos.cli._secret import ask_password

    if meaning is None:
        if why:
            raise BadInput("A comment needs a signature.", remedy="Give --meaning too.")
        with open_log(where) as log:
            _show(run, signatures_under(log, run), as_json=as_json)
        return
    with need_lab_of(where) as client:
        user = client.identity()["user"]
        signature = client.sign_run(run, meaning, ask_password(f"Password of {user}"), why=why)
    tell(_line(signature), signature, as_json=as_json)


def _show(run: str, found: Sequence[Signature], *, as_json: bool) -> None:
    if as_json:
        show_json(found)
        return
    lines = [_line(msgspec.structs.asdict(each)) for each in found]
    click.echo("\n".join(lines) or f"{run} has no signatures.")


def _line(signature: dict[str, object]) -> str:
    comment = f": {signature['why']}" if signature["why"] else ""
    broken = "" if signature["holds"] else " - THE RECORD IS ANOTHER NOW"
    when = str(signature["time"])[:19].replace("T", " ")
    return f"{when} UTC  {signature['by']} signed {signature['run']}: {signature['meaning']}{comment}{broken}"
