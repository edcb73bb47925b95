"""Entries of the search index. The number of an entry consists of its first event and its place in that
event. So the entry is found again when there is more information about it, and later entries have higher
numbers.
"""

from __future__ import annotations

import mimetypes
from collections.abc import Iterable, Mapping
from typing import Any

from labos.audit._bench_tables import LABWARE_TABLE as LABWARE
from labos.audit._entry_tables import ENTRIES
from labos.audit._rows import Row, RowChanges
from labos.audit._work_tables import ACTIONS, EXPERIMENTS, RUNS
from labos.audit.words import join_words
from labos.core import actions as a
from labos.core import experiments as x
from labos.core import runs as r
from labos.core.envelope import Envelope
from labos.core.ids import workcell_of
from labos.core.labware import SamplesRegistered
from labos.core.wells import parse_well
from labos.services.files import iterate_files
from labos.services.results import iterate_tables

PLACES = 1 << 20
"""The largest number of entries that one event may create."""
SAMPLES_FROM = 1 << 16
"""The places of samples of labware come after other entries of its first event."""
COLUMNS = 1000
"""More than the largest number of wells."""
LONGEST_TEXT = 2000
MOST_LISTED = 200


def _put(rows: RowChanges, position: int, place: int, kind: str, name: str, at: float, **fields: Any) -> Row:
    """Write an entry; missing fields are empty. ``fields['also']`` are further words by which it can be
    found."""
    also = fields.pop("also", ())
    lists: Row = {"keywords": [], "creators": [], "files": []}
    number = position * PLACES + place
    row = rows.put(ENTRIES, number=number, kind=kind, name=name, at_s=at, **{**lists, **fields})
    searched = ("name", "title", "about", "user_id", "workcell", "workflow", "experiment", "run", "module")
    row["words"] = join_words([*(row[part] for part in (*searched, *lists)), kind, also])
    return row


def _add_words(row: Row, *values: Any) -> None:
    row["words"] = join_words([row["words"], values])


# -- experiments and runs ----------------------------------------------------------------------


def on_experiment_started(rows: RowChanges, event: x.ExperimentStarted, head: Envelope, at: float) -> None:
    _put(
        *(rows, head.position, 0, "experiment", event.experiment, at),
        title=event.name,
        workflow=event.name,
        experiment=event.experiment,
        user_id=event.user,
        status="open",
    )


def on_experiment_changed(
    rows: RowChanges,
    event: x.ExperimentCancelled | x.ExperimentClosing | x.ExperimentEnded,
    head: Envelope,
    at: float,
) -> None:
    experiment = rows.get(EXPERIMENTS, event.experiment)
    entry = rows.update(ENTRIES, experiment["started_position"] * PLACES, status=experiment["status"])
    _add_words(entry, experiment["why"])


def on_submitted(rows: RowChanges, event: r.RunSubmitted, head: Envelope, at: float) -> None:
    run = rows.get(RUNS, event.run)
    _put(
        *(rows, head.position, 0, "run", event.run, at),
        title=event.workflow,
        user_id=event.user,
        workcell=run["workcell"],
        workflow=event.workflow,
        experiment=event.experiment,
        run=event.run,
        status=run["status"],
        also=(event.campaign, event.payload),
    )


def on_run_changed(
    rows: RowChanges,
    event: r.RunStarted | r.RunPaused | r.RunResumed | r.RunCancelling | r.RunLeaving | r.RunEnd,
    head: Envelope,
    at: float,
) -> None:
    run = rows.get(RUNS, event.run)
    entry = rows.update(ENTRIES, run["submitted_position"] * PLACES, status=run["status"])
    _add_words(entry, run["why"])


# -- results of steps --------------------------------------------------------------------------


def on_result(
    rows: RowChanges, event: a.ActionSucceeded | a.ActionReconciled, head: Envelope, at: float
) -> None:
    """Add the measured values, and each file."""
    action = rows.get(ACTIONS, event.action)
    if not action["action"] or event.result is None:
        return
    run = rows.get(RUNS, event.run)
    about: dict[str, Any] = {
        "user_id": run["user_id"],
        "workcell": workcell_of(event.module),
        "workflow": run["workflow"],
        "experiment": run["experiment"],
        "run": event.run,
        "module": event.module,
    }
    step = f"{event.run}#{event.step}" if event.run else event.action
    key = action["key"] or action["name"]
    plate = action["plate"]
    on_plate = f" of {plate}" if plate else ""
    found = list(iterate_tables(event.result))
    if found:
        measured = list(dict.fromkeys(table.quantity for table in found))[:MOST_LISTED]
        wells = {well for table in found for well in table.values}
        samples = [s for well, s in samples_of(rows, plate).items() if well in wells]
        title = f"{', '.join(measured)}{on_plate}"
        units = [table.unit for table in found]
        also = (key, action["name"], samples, units, plate)
        _put(
            *(rows, head.position, 0, "result", step, at),
            **about,
            title=title[:LONGEST_TEXT],
            keywords=measured,
            also=also,
        )
    for place, (name, digest, size) in enumerate(iterate_files(event.result), 1):
        _put(
            *(rows, head.position, place, _kind_of(name), digest, at),
            **about,
            title=f"{name}{on_plate}",
            files=_list_readings([(name, digest, size)]),
            also=(key, action["name"], step, plate),
        )


def _kind_of(name: str) -> str:
    return "image" if (mimetypes.guess_type(name)[0] or "").startswith("image/") else "file"


def _list_readings(files: Iterable[tuple[str, str, int]]) -> list[dict[str, Any]]:
    return [{"file": name, "sha256": digest, "bytes": size} for name, digest, size in files][:MOST_LISTED]


# -- samples -----------------------------------------------------------------------------------


def samples_of(rows: RowChanges, labware: str) -> Mapping[str, str]:
    """The samples of labware so far, by well."""
    samples: Mapping[str, str] = rows.get(LABWARE, labware)["samples"]
    return samples


def on_samples_registered(
    rows: RowChanges, event: SamplesRegistered, head: Envelope, at: float, before: Mapping[str, str]
) -> None:
    """Add a sample sheet, which replaces the one ``before``."""
    labware = rows.get(LABWARE, event.labware)
    if not labware["labware"]:
        return
    first = labware["placed_position"] * PLACES + SAMPLES_FROM
    run = rows.get(RUNS, event.run)
    for well in before:
        if well not in labware["samples"] and (place := _place(well)) is not None:
            rows.update(ENTRIES, first + place, status="replaced")
    for well, sample in labware["samples"].items():
        place = _place(well)
        if place is None:
            continue
        _put(
            *(rows, labware["placed_position"], SAMPLES_FROM + place, "sample"),
            *(f"{event.labware}/{well}", at),
            title=sample,
            user_id=head.actor,
            workcell=workcell_of(labware["station"]),
            workflow=run["workflow"],
            experiment=run["experiment"],
            run=event.run,
            also=(labware["type"], labware["barcode"]),
        )


def _place(well: str) -> int | None:
    """The place of a well's entry among those of its labware; None if it is not a well."""
    try:
        row, column = parse_well(well)
    except ValueError:
        return None
    return row * COLUMNS + column


# -- publications ------------------------------------------------------------------------------


def on_noted(rows: RowChanges, event: x.ExperimentNoted, head: Envelope, at: float) -> None:
    experiment = rows.get(EXPERIMENTS, event.experiment)
    if event.kind != "publication":
        _add_words(rows.change(ENTRIES, experiment["started_position"] * PLACES), event.name)
        return
    facts = event.facts
    _put(
        *(rows, head.position, 0, "publication", f"{event.experiment}@{head.position}", at),
        title=_text(facts.get("title")) or event.name,
        about=_text(facts.get("about")),
        user_id=experiment["user_id"] or head.actor,
        workflow=experiment["name"],
        experiment=event.experiment,
        status="published",
        keywords=_texts(facts.get("keywords")),
        creators=_texts(facts.get("creators")),
        files=_list_readings(iterate_files(facts)),
        also=(event.name, facts.get("runs")),
    )


def _text(value: Any) -> str:
    """The text in a fact of an application, which may note anything."""
    return value[:LONGEST_TEXT] if isinstance(value, str) else ""


def _texts(value: Any) -> list[str]:
    listed = value if isinstance(value, list | tuple) else ()
    return [_text(item) for item in listed if isinstance(item, str) and item][:MOST_LISTED]


"""They run after those of the other tables, because they read their rows."""
