"""Foreign files, rewritten in LabOS' own form, with the assumptions that were necessary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import msgspec

from labos.core.ids import local
from labos.core.model import Description
from labos.spec.about import describe_modules
from labos.spec.carrying import TransferEnd, TransferReader, add_ends, drop_ends
from labos.spec.comments import place_comments, read_comments
from labos.spec.dialects import (
    NOBODYS,
    Dialect,
    Kind,
    convert_labware,
    convert_workcell,
    convert_workflow,
    detect_kind,
)
from labos.spec.emit import to_yaml
from labos.spec.findings import Finding, FindingList
from labos.spec.interfaces import is_configured
from labos.spec.models import LabwareFile, StationEntry, WorkcellFile, WorkflowFile
from labos.spec.parts import Part
from labos.spec.serving import match_driver
from labos.spec.source import Source
from labos.spec.uses import Use
from labos.spec.validation import expect_valid
from labos.spec.workcell import CompiledWorkcell, compile_workcell

NAMES: dict[Dialect, str] = {"labos": "LabOS", "wei": "WEI", "madsci": "MADSci", "opentrons": "Opentrons"}


Moved = tuple[TransferReader, set[TransferEnd]]
"""The ends of transfers that a workcell's file has now, instead of its workflows."""


class Imported(msgspec.Struct, frozen=True):
    """A file in LabOS' own form. ``text`` is empty if it was in that form before. ``findings`` are the
    assumptions, and ``counts`` the numbers of its parts. ``moved`` is the data that was moved from workflows
    to the workcell's file."""

    kind: Kind
    dialect: Dialect
    name: str
    text: str
    findings: tuple[Finding, ...] = ()
    counts: dict[str, int] = {}
    moved: Moved | None = None


def import_spec(
    source: Source,
    descriptions: Mapping[str, Description],
    uses: Sequence[Use] | None = None,
    moved: Sequence[Moved] = (),
) -> Imported:
    """Rewrite a file. If ``uses`` by workflows are given, missing parts of a workcell are drafted from them.
    ``moved`` has the data of the workcells on which a workflow runs. Raises SpecError or SpecErrors for a
    file that cannot be used."""
    kind, _ = detect_kind(source)
    if kind == "labware":
        return _import_labware(source)
    if kind == "workflow":
        return _import_workflow(source, moved)
    return _import_workcell(source, descriptions, uses)


def _import_labware(source: Source) -> Imported:
    report = FindingList(source.file)
    form, dialect = convert_labware(source, report)
    file = expect_valid(LabwareFile, form, report)
    text = "" if dialect == "labos" else _write_text(file, source, form, dialect, report.sort_findings())
    name = PurePath(source.file).stem
    return Imported("labware", dialect, name, text, report.sort_findings(), {"types": len(file.labware)})


def _import_workflow(source: Source, moved: Sequence[Moved]) -> Imported:
    report = FindingList(source.file)
    form, dialect = convert_workflow(source, report)
    file = expect_valid(WorkflowFile, form, report)
    file, is_shorter = (file, False) if dialect == "labos" else drop_ends(file, moved)
    notes = {"": ["How labware is gripped stands in the workcell's file."]} if is_shorter else {}
    text = (
        "" if dialect == "labos" else _write_text(file, source, form, dialect, report.sort_findings(), notes)
    )
    counts = {"steps": len(file.steps), "parameters": len(file.parameters)}
    return Imported("workflow", dialect, file.name, text, report.sort_findings(), counts)


def _import_workcell(
    source: Source, descriptions: Mapping[str, Description], uses: Sequence[Use] | None
) -> Imported:
    cell = compile_workcell(source, descriptions, uses=uses)
    form, dialect = convert_workcell(source, FindingList(source.file))
    file = cell.file
    text, moved = "", None
    if dialect != "labos":
        carrying = TransferReader(cell, descriptions)
        moved = (carrying, carrying.find_agreed(uses or ()))
        file, notes = add_ends(complete_workcell(file, cell, descriptions), moved[1])
        text = _write_text(file, source, form, dialect, cell.findings, notes)
    counts = {
        "modules": len(file.modules),
        "stations": sum(not station.hotel for station in cell.workcell.stations),
    }
    return Imported("workcell", dialect, file.name, text, cell.findings, counts, moved)


def complete_workcell(
    file: WorkcellFile, cell: CompiledWorkcell, descriptions: Mapping[str, Description]
) -> WorkcellFile:
    """A foreign workcell with all assumptions written out: modules without a driver are not active, drivers
    that were found by a module's name are named, and every place is a station. Interfaces without settings
    are left out."""
    drivers = {local(module.name): module.driver for module in cell.workcell.modules}
    modules = []
    for entry in file.modules:
        change: dict[str, Any] = {}
        if entry.active and entry.name not in drivers:
            change["active"] = False
        elif entry.active and entry.about is None:
            by_model = match_driver(entry.model, descriptions) if entry.model else None
            if drivers[entry.name] != by_model:
                change["driver"] = drivers[entry.name]
        if not is_configured(entry.interface, entry.config):
            change["interface"] = ""
        modules.append(entry.model_copy(update=change))
    known_stations = {
        f"{local(name)}.{station.name}"
        for name, known in describe_modules(cell.workcell, descriptions).items()
        for station in known.stations
    }
    stations = dict(file.stations)
    for station in cell.workcell.stations:
        name = local(station.name)
        if name not in known_stations and name not in stations:
            stations[name] = StationEntry(kind=station.kind)
    names = {entry.name for entry in modules}
    config = dict(file.config)
    nobodys = {owner: dict(places) for owner, places in config.get(NOBODYS, {}).items()}
    for owner, written in file.locations.items():
        if owner not in names and owner != "workcell":
            taught = {place: joints for place, joints in written.items() if joints}
            nobodys[owner] = {**taught, **nobodys.get(owner, {})}
    if any(nobodys.values()):
        config[NOBODYS] = {owner: places for owner, places in nobodys.items() if places}
    locations = {
        owner: places
        for owner, written in file.locations.items()
        if owner in names or owner == "workcell"
        if (places := {place: joints for place, joints in written.items() if joints or owner != "workcell"})
    }
    change = {"modules": modules, "stations": stations, "locations": locations, "config": config}
    return file.model_copy(update=change)


def _write_text(
    file: Part,
    source: Source,
    form: Source,
    dialect: Dialect,
    findings: tuple[Finding, ...],
    notes: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """The file as YAML, with its own comments, and with the assumptions as comments. ``notes`` are more
    comments, by field."""
    head = f"Imported from {PurePath(form.file).name} ({NAMES[dialect]})."
    own, below = place_comments(read_comments(source.text), form.data)
    comments = {"": [f"{head} What had to be assumed stands below." if findings else head]}
    for field, texts in [*(notes or {}).items(), *own.items()]:
        comments.setdefault(field, []).extend(texts)
    for finding in findings:
        where = "" if finding.file == form.file else f" of {PurePath(finding.file).name}"
        comment = f"Line {finding.line}{where}: {finding.message}"
        comments.setdefault(_find_home(finding.field, form, file), []).append(comment)
    return to_yaml({"labos": 1, **file.model_dump(exclude_defaults=True, by_alias=True)}, comments, below)


def _find_home(field: str, form: Source, file: Part) -> str:
    """The field in LabOS' form that corresponds to a field of the foreign file."""
    for place in getattr(file, "stations", {}):
        if field.startswith("locations.") and field.endswith(f".{place}"):
            return f"stations.{place}"
    for before, now in form.moved.items():
        if field == before or field.startswith((f"{before}.", f"{before}[")):
            return now + field[len(before) :]
    return field
