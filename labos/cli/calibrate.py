"""``labos calibrate``: record a calibration of a module."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from labos.cli._complete import make_completer
from labos.cli._options import Asker, asker_options, file_option, why_option
from labos.cli._out import report_done
from labos.errors import BadInput


@click.command("calibrate")
@click.argument("module", shell_complete=make_completer("module"))
@click.option(
    "--what",
    default="",
    metavar="TEXT",
    help="The calibrated quantity, such as `volume`; otherwise the whole module.",
)
@click.option("--certificate", default="", metavar="TEXT", help="The certificate's number.")
@file_option("--file", "report", metavar="REPORT", help="The report; it is stored with the lab's files.")
@click.option("--until", default="", metavar="DATE", help="The last day on which it is valid: 2027-01-01.")
@why_option()
@asker_options
def command(module: str, report: Path | None, asker: Asker, **details: Any) -> None:
    """Record that MODULE was calibrated. `labos provenance` shows this calibration for all later actions. It
    replaces the earlier calibration with the same `--what`.

    To correct a calibration, record it again. To withdraw it, record it again with a day in the past as
    `--until`. The log keeps all of them. No run waits for a calibration, and no run stops because a
    calibration has expired. `labos doctor` warns two weeks before it expires.

    \b
    labos calibrate ot2_cp_gamma --what volume --certificate K-2041 --until 2027-01-01
    labos calibrate hidex --file report.pdf --why "new lamp"
    """

    content = b"" if report is None else _read(report)
    with asker.lab() as client:
        found = client.calibrate(module, asker.user, report=content, **details)
    of = f"{found['module']} ({found['what']})" if found["what"] else found["module"]
    valid = f", valid until {found['until']}" if found["until"] else ""
    kept = f" Its report is kept as {found['file']}." if found["file"] else ""
    report_done(f"The calibration of {of} is recorded{valid}.{kept}", found)


def _read(report: Path) -> bytes:
    """Raises BadInput."""
    from labos.client._files import LARGEST_FILE

    try:
        if report.stat().st_size > LARGEST_FILE:
            raise BadInput(
                f"{report} is larger than {LARGEST_FILE >> 20} MB.", remedy="Give a smaller report."
            )
        content = report.read_bytes()
    except OSError as error:
        raise BadInput(f"{report} cannot be read: {error.strerror}.", remedy="Check its path.") from None
    if not content:
        raise BadInput(f"{report} is empty.", remedy="Give another file, or leave --file out.")
    return content
