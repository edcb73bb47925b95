"""``labos teach`` and ``labos locations``: the poses at which arms reach stations."""

from __future__ import annotations

from typing import Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._options import Asker, asker_options, lab_and_json, why_option
from labos.cli._out import end_with_json, report_done, show_table
from labos.settings import Settings


@click.command("teach")
@click.argument("module", shell_complete=make_completer("module"))
@click.argument("station", shell_complete=make_completer("station"))
@click.option(
    "--pose", required=True, metavar="X,Y,…", help="Joint angles or coordinates, as the driver requires."
)
@why_option()
@click.option(
    "--type",
    "kind",
    default="",
    metavar="TYPE",
    help="For labware of this type only; otherwise for all types without their own pose.",
)
@asker_options
def teach(module: str, station: str, pose: str, why: str, kind: str, asker: Asker) -> None:
    """Set the pose at which the arm MODULE reaches STATION. Each pose is logged as a new version, and the
    arm's node is restarted with it. The first move to the station is slow if the driver's action has an
    argument `slow`. A pose for a labware type takes precedence over the pose for the station.

    \b
    labos teach pf400 sealer.default --pose 190.1,10.2,50.5,260.0,640.7,-480.2
    labos teach pf400 sealer.default --type pcr96 --pose 188.6,10.2,50.5,260.0,640.7,-480.2
    """

    try:
        numbers = [float(part) for part in pose.split(",")]
    except ValueError:
        raise click.BadParameter(f"{pose!r} is not a list of numbers.", param_hint="--pose") from None
    with asker.lab() as client:
        version = client.teach(module, station, numbers, asker.user, why, labware_type=kind)
    what = f"{station} with a {kind}" if kind else station
    facts = {"module": module, "station": station, "type": kind, "version": version}
    report_done(f"{module} now reaches {what} with version {version} of the pose.", facts)


@click.command("locations")
@click.argument("module", shell_complete=make_completer("module"))
@lab_and_json
def locations(module: str, asker: Asker) -> None:
    """List the poses at which the arm MODULE reaches its stations. Version 0 is the one in the workcell file.
    Older versions are in the log: `labos log --type location.taught`.

    \b
    labos locations pf400
    """

    found = _find_locations(module, asker.home)
    end_with_json(found)
    rows = [
        (name, kind, at)
        for name, own in found.items()
        for kind, at in (("", own), *sorted(own.get("types", {}).items()))
    ]
    show_table(
        ["station", "type", "version", "tried", "pose"],
        [
            [name, kind, str(at["version"]), "yes" if at["proven"] else "no", ", ".join(map(str, at["pose"]))]
            for name, kind, at in rows
        ],
    )


def _find_locations(module: str, home: str | None) -> dict[str, dict[str, Any]]:
    """From the running lab, else from its log. Raises NotFound."""
    from labos.cli._lab import find_lab

    if (lab := find_lab(home)) is not None:
        with lab as client:
            return client.locations(module)
    from labos.cli._liveness import module_of, read_last_state
    from labos.http.teaching import make_locations as poses_of

    return dict(msgspec.to_builtins(poses_of(module_of(read_last_state(Settings.make(home)), module))))
