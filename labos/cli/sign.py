"""``labos sign``: an electronic signature for a run, an experiment or a campaign."""

from __future__ import annotations

from collections.abc import Sequence

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._lab import need_lab_of
from labos.cli._options import why_option
from labos.cli._out import end_with_json, report_done
from labos.cli._people import ask_password
from labos.cli._query import Where, log_and_json, open_log
from labos.core.signatures import MEANINGS
from labos.errors import BadInput
from labos.services.signatures import Signature, find_kind, list_signatures


@click.command("sign", short_help="Sign the record of a run, an experiment or a campaign.")
@click.argument("subject", metavar="ID", shell_complete=make_completer("run", "experiment"))
@click.option("--meaning", type=click.Choice(MEANINGS), help="The meaning of the signature.")
@why_option("A comment, for the log.")
@log_and_json
def command(where: Where, subject: str, meaning: str | None, why: str) -> None:
    """Sign the record of an ended run, experiment or campaign. The command asks for your password again.

    The signature is an event with user, time, meaning, and the digest of all records of the run. So it is
    valid for this run only. For an experiment or a campaign, the digest also covers the records of all its
    runs. The signature is part of the bundle. Without --meaning, the command shows the signatures. Without
    a terminal, it reads the password from the first line of standard input.

    \b
    labos sign R7 --meaning reviewed --why "checked against the protocol"
    labos sign E3 --meaning approved      an experiment with all its runs
    labos sign C5 --meaning approved      a campaign with all its runs
    labos sign R7
    """
    with open_log(where) as log:
        if meaning is None and why:
            raise BadInput("A comment needs a signature.", remedy="Give --meaning too.")
        kind = find_kind(log, subject)
        if meaning is None:
            _show(subject, list_signatures(log, subject))
            return
    with need_lab_of(where) as client:
        user = client.identity()["user"]
        sign = {
            "run": client.sign_run,
            "experiment": client.sign_experiment,
            "campaign": client.sign_campaign,
        }[kind]
        signature = sign(subject, meaning, ask_password(f"Password of {user}"), why=why)
    report_done(_line(signature), signature)


def _show(subject: str, found: Sequence[Signature]) -> None:
    end_with_json(found)
    lines = [_line(msgspec.structs.asdict(each)) for each in found]
    click.echo("\n".join(lines) or f"{subject} has no signatures.")


def _line(signature: dict[str, object]) -> str:
    comment = f": {signature['why']}" if signature["why"] else ""
    broken = "" if signature["holds"] else " - THE RECORD HAS CHANGED SINCE"
    when = str(signature["time"])[:19].replace("T", " ")
    what = _describe_subject(signature)
    return f"{when} UTC  {signature['by']} signed {what}: {signature['meaning']}{comment}{broken}"


def _describe_subject(signature: dict[str, object]) -> str:
    """``R7``; ``E3 with 4 runs``."""
    if signature["kind"] == "run":
        return str(signature["subject"])
    runs = signature["runs"]
    return f"{signature['subject']} with {runs} run{'' if runs == 1 else 's'}"
