"""``labos samples``: the samples in wells."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import click

from labos.cli._complete import make_completer
from labos.cli._group import Suggesting
from labos.cli._liveness import open_current_log
from labos.cli._options import Asker, asker_options
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_at_and_json, open_contents
from labos.core.wells import parse_well
from labos.errors import NotFound
from labos.services.history import find_position_at
from labos.services.results import Registration, list_registrations
from labos.services.times import Moment, iso_time, show_time


@click.group("samples", cls=Suggesting, short_help="Register or show the samples in the wells of a plate.")
def command() -> None:
    """Register or show sample sheets. A sheet lists the samples in the wells of a plate.

    A sheet is a CSV file with the columns well and sample. The columns plate, volume and unit are optional
    (nL, µL, mL or L; µL if there is no unit):

    \b
    plate,well,sample,volume,unit
    P7,A1,patient-0001,50,uL
    P7,A2,water,50,uL

    The log keeps names of samples forever. Use codes, not names of persons.
    """


@command.command("load")
@click.argument("sheet", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--plate", default="", metavar="ID", help="The id or barcode of the plate, if the sheet does not name it."
)
@click.option(
    "--station",
    default="",
    metavar="STATION",
    help="The station of the plate, if the sheet does not name it.",
)
@click.option("--replace", is_flag=True, help="Replace an earlier sheet.")
@asker_options
def load(sheet: Path, plate: str, station: str, replace: bool, asker: Asker) -> None:
    """Register the samples of SHEET in the running lab. If the sheet has errors, no sample is registered;
    each error is reported with its line and column.

    \b
    labos samples load sheet.csv
    labos samples load sheet.csv --plate P7
    labos samples load sheet.csv --station ot2_pcr_alpha.deck1_cooler
    """
    with asker.lab() as client:
        found = client.load_samples(sheet, asker.user, labware=plate, station=station, replace=replace)
    end_with_json(found)
    for name, count in found.items():
        click.echo(f"{name} holds {count} samples.")


@command.command("show")
@click.argument("plate", shell_complete=make_completer("labware"))
@click.option("--csv", "as_csv", is_flag=True, help="Print a sheet that can be loaded again.")
@log_at_and_json
def show(where: Where, plate: str, as_csv: bool, moment: Moment) -> None:
    """Show the samples of PLATE from its last sheet. The plate may have left the bench.

    \b
    labos samples show P7
    labos samples show P7 --csv > sheet.csv
    """
    with open_current_log(where, moment) as store, open_contents(where) as blobs:
        found = list_registrations(store, blobs, plate, find_position_at(store, moment))
    if not found:
        raise NotFound(
            f"No samples of {plate!r} are known.",
            remedy=f"Load them: labos samples load SHEET --plate {plate}",
        )
    last = found[-1]
    in_order = sorted(last.samples, key=lambda item: parse_well(item.well))
    end_with_json(_list_facts(last, len(found)))
    if as_csv:
        out = csv.writer(sys.stdout, lineterminator="\n")
        out.writerow(("plate", "well", "sample", "volume", "unit"))
        for item in in_order:
            volume = "" if item.volume_ul is None else f"{item.volume_ul:g}"
            out.writerow((plate, item.well, item.sample, volume, "uL" if volume else ""))
    else:
        more = f"; {len(found) - 1} earlier sheets" if len(found) > 1 else ""
        title = f"{plate}: {len(last.samples)} samples by {last.by}, {show_time(last.at)}{more}"
        rows = [
            (item.well, item.sample, "" if item.volume_ul is None else f"{item.volume_ul:g} µL")
            for item in in_order
        ]
        show_table(("well", "sample", "volume"), rows, title=title)


def _list_facts(last: Registration, sheets: int) -> dict[str, object]:
    return {
        "plate": last.labware,
        "sheet": last.sheet,
        "position": last.position,
        "time": iso_time(last.at),
        "by": last.by,
        "sheets": sheets,
        "samples": last.samples,
    }
