"""``labos workcell``: changes a workcell while its lab runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._group import Suggesting
from labos.cli._options import Asker, asker_options
from labos.cli._out import show_json, show_lines, wants_json
from labos.spec import Finding
from labos.spec.labware import read_labware_files
from labos.spec.source import read
from labos.spec.tables import read_table_files

SIGNS = {"added": "+", "removed": "-", "changed": "~"}


@click.group("workcell", cls=Suggesting)
def command() -> None:
    """Manage workcells of the running lab."""


@command.command("apply")
@click.argument("file", shell_complete=make_completer("workcell file"))
@click.option("--dry-run", is_flag=True, help="Only show what would change, and what prevents it.")
@click.option("--yes", is_flag=True, help="Do not ask first.")
@asker_options
def apply(file: str, dry_run: bool, yes: bool, asker: Asker) -> None:
    """Apply the present content of FILE to a workcell of the running lab.

    The command shows additions (+), removals (-) and changes (~), also of labware types. It refuses to
    remove modules and stations that hold labware, may hold labware, are in use, or are needed by queued
    or active runs, and names the obstacle. If `labos up` starts the nodes, nodes of new modules start
    and nodes of removed modules end.

    \b
    labos workcell apply rpl.yaml --dry-run
    labos workcell apply rpl.yaml --yes
    """
    from labos.bootstrap import descriptions
    from labos.cli._lab import find_workcell_file

    path = Path(find_workcell_file(file))
    text = path.read_text(encoding="utf-8-sig")
    with asker.lab() as client:
        source = read(path, last_wins=True)
        labware, files = read_labware_files(source), read_table_files(source, descriptions())
        found = client.apply_workcell(text, str(path), asker.user, dry_run=True, labware=labware, files=files)
        if not wants_json():
            _show(found)
        if not dry_run and _list_changes(found):
            if not (yes or wants_json() or found["blockers"]):
                click.confirm("Apply it?", abort=True)
            found = client.apply_workcell(text, str(path), asker.user, labware=labware, files=files)
            if not wants_json():
                click.echo(f"{found['workcell']} is changed.")
    if wants_json():
        show_json(found)


def _list_changes(found: dict[str, Any]) -> list[str]:
    return [
        f"{sign} {what.removesuffix('s')} {name}{_describe_details(found, what, kind, name)}"
        for what in ("modules", "stations", "poses", "labware", "transfers")
        for kind, sign in SIGNS.items()
        for name in found[what][kind]
    ]


def _describe_details(found: dict[str, Any], what: str, kind: str, name: str) -> str:
    """The changed fields of a module."""
    changed = found["details"].get(name) if (what, kind) == ("modules", "changed") else None
    return f" ({'; '.join(changed)})" if changed else ""


def _show(found: dict[str, Any]) -> None:
    for finding in found["findings"]:
        click.echo(f"labos: {msgspec.convert(finding, Finding)}", err=True)
    lines = _list_changes(found)
    show_lines(lines or [f"{found['workcell']} agrees with the file."])
    show_lines(found["blockers"], "Prevented by: ")
