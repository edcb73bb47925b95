"""Results by well: values that steps measured, joined with the samples that were in the wells.

A result is a table by well if it is an object with ``wells``: well → number, text or true/false, or well →
such values by quantity. ``quantity`` and ``unit`` beside it describe the values. Without ``wells``, an object
whose keys are all wells is a table too. A list, or a list under ``tables``, holds several tables.
"""

from __future__ import annotations

import bisect
import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import msgspec

from labos.core.actions import ActionReconciled, ActionRequested, ActionSucceeded
from labos.core.effects import Move, Needs, Relid, Unlid
from labos.core.labware import Sample, SamplesRegistered
from labos.core.wells import well_key
from labos.errors import BadInput, LogDamaged, NotFound
from labos.ports import BlobReader, LogQuery
from labos.services.catalogue import read_catalogue
from labos.services.log import Log, decode_events
from labos.services.times import iso_time

if TYPE_CHECKING:
    import pandas

COLUMNS = ("run", "step", "plate", "well", "sample", "quantity", "value", "unit", "time")

_KINDS = (ActionRequested.TYPE, ActionSucceeded.TYPE, ActionReconciled.TYPE)
_WELL = re.compile(r"([A-Z]{1,2})0*([1-9][0-9]?)")


class Reading(msgspec.Struct, frozen=True):
    """One value of one well. ``plate`` is empty if the step worked on no labware or on several pieces;
    ``time`` is when the step ended, by its device's clock if the device reported it (UTC ns)."""

    run: str
    step: str
    plate: str
    well: str
    sample: str
    quantity: str
    value: float | bool | str
    unit: str
    time: int


class Readings(list[Reading]):
    """The values that a run measured, well by well."""

    def rows(self, show: Callable[[int], str] = iso_time) -> list[tuple[Any, ...]]:
        """The values of ``COLUMNS`` for each reading; ``show`` formats the times (in UTC)."""
        return [(*(getattr(each, name) for name in COLUMNS[:-1]), show(each.time)) for each in self]

    def to_csv(self, file: str | Path | TextIO | None = None) -> str:
        """The readings as CSV; if ``file`` is given, they are also written there. Times in UTC."""
        text = io.StringIO()
        out = csv.writer(text, lineterminator="\n")
        out.writerow(COLUMNS)
        out.writerows(self.rows())
        if isinstance(file, str | Path):
            Path(file).write_text(text.getvalue(), encoding="utf-8", newline="")
        elif file is not None:
            file.write(text.getvalue())
        return text.getvalue()

    def to_frame(self) -> pandas.DataFrame:
        """As a pandas table; ``time`` is a time in UTC. Raises BadInput without pandas."""
        try:
            import pandas
        except ImportError:
            raise BadInput(
                "A table needs pandas.", remedy='Install it: pip install "labos-sdl[analysis]"'
            ) from None
        frame = pandas.DataFrame(self.rows(lambda time: str(time)), columns=list(COLUMNS))
        frame["time"] = pandas.to_datetime(frame["time"].astype("int64"), unit="ns", utc=True)
        return frame


class ValueTable(msgspec.Struct, frozen=True):
    """Values of one quantity by well."""

    quantity: str
    unit: str
    values: dict[str, float | bool | str]


class Registration(msgspec.Struct, frozen=True):
    """The content of one sheet for one plate; ``position`` is its position in the log."""

    labware: str
    sheet: str
    position: int
    at: int
    by: str
    samples: tuple[Sample, ...]
    """In the order of the plate: A1, A2, A10, B1."""


def list_registrations(
    log: Log, blobs: BlobReader, labware: str, upto: int | None = None
) -> list[Registration]:
    """The sheets of a plate, in order; the last one is valid. Raises NotFound and LogDamaged for a blob that
    is missing or changed."""
    query = LogQuery(types=(SamplesRegistered.TYPE,), mentions=labware, upto=upto)
    found: list[Registration] = []
    for event, head in decode_events(log.select(query)):
        if isinstance(event, SamplesRegistered) and event.labware == labware:
            samples = event.wells or _unpack(blobs, event.blob, head.position)
            wells = tuple(sorted(samples, key=lambda sample: well_key(sample.well)))
            found.append(
                Registration(event.labware, event.sheet, head.position, head.recorded_at, head.actor, wells)
            )
    return found


def _unpack(blobs: BlobReader, blob: str, position: int) -> tuple[Sample, ...]:
    try:
        return msgspec.json.decode(blobs.get(blob), type=tuple[Sample, ...])
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise LogDamaged(f"The blob {blob} holds no samples ({error}).", position=position) from None


def read_readings(log: Log, blobs: BlobReader, run: str, upto: int | None = None) -> Readings:
    """Every value by well that a run's steps returned, in the order of the steps' ends and of the plates'
    wells. The samples are those of the last sample sheet of the plate before the step ended; if there was
    none, those of the first sheet after. Raises NotFound for an unknown run."""
    names = read_catalogue(log, upto)
    if run not in names.runs:
        raise NotFound(f"There is no run {run!r} in this log.", remedy="List them: labos runs --all")
    sheets: dict[str, list[Registration]] = {"": []}
    plates: dict[str, str] = {}
    found = Readings()
    query = LogQuery(streams=(run,), types=_KINDS, upto=upto)
    for event, head in decode_events(log.select(query)):
        if isinstance(event, ActionRequested):
            plates[event.action] = find_labware_of_action(event)
        elif isinstance(event, ActionSucceeded | ActionReconciled):
            plate = plates.get(event.action, "")
            step = names.find_step(run, event.step)
            key = step.key if step is not None else str(event.step)
            ended = getattr(event, "ended_ns", 0) or head.recorded_at
            for table in iterate_tables(event.result):
                if plate not in sheets:
                    sheets[plate] = list_registrations(log, blobs, plate, upto)
                samples = _find_samples_at(sheets[plate], head.position)
                for well, value in table.values.items():
                    found.append(
                        Reading(
                            *(run, key, plate, well, samples.get(well, "")),
                            *(table.quantity, value, table.unit, ended),
                        )
                    )
    return found


def iterate_tables(result: Any) -> Iterator[ValueTable]:
    """The tables by well in a step's result; most results have none."""
    if isinstance(result, list):
        for item in result:
            if isinstance(item, dict):
                yield from iterate_tables(item)
    elif isinstance(result, dict):
        if isinstance(result.get("tables"), list):
            yield from iterate_tables(result["tables"])
        elif isinstance(result.get("wells"), dict):
            yield from _split_by_quantity(result["wells"], result)
        elif result and all(_match_well(key) for key in result):
            yield from _split_by_quantity(result, {})


def _split_by_quantity(wells: Mapping[str, Any], about: Mapping[str, Any]) -> Iterator[ValueTable]:
    """One table for each quantity. Values outside a well, and entries that are not values, are left out."""
    found: dict[str, dict[str, float | bool | str]] = {}
    units = about.get("units")
    units = units if isinstance(units, dict) else {}
    plain = str(about.get("quantity") or "value")
    for name, value in wells.items():
        well = _match_well(name)
        if not well:
            continue
        for quantity, item in (value if isinstance(value, dict) else {plain: value}).items():
            if isinstance(item, int | float | bool | str):
                found.setdefault(str(quantity), {})[well] = item
    for quantity, values in found.items():
        values = dict(sorted(values.items(), key=lambda item: well_key(item[0])))
        yield ValueTable(quantity, str(units.get(quantity, about.get("unit") or "")), values)


def _match_well(name: str) -> str:
    match = _WELL.fullmatch(name.upper())
    return f"{match[1]}{match[2]}" if match else ""


def find_labware_of_action(event: ActionRequested) -> str:
    """The labware on which an action worked, if the event is the end of an action on labware."""
    touched = {
        effect.plate if isinstance(effect, Unlid | Relid) else effect.labware
        for effect in event.effects
        if isinstance(effect, Needs | Move)
    }
    return str(touched.pop()) if len(touched) == 1 else ""


def _find_samples_at(sheets: list[Registration], position: int) -> dict[str, str]:
    if not sheets:
        return {}
    last = bisect.bisect_left([sheet.position for sheet in sheets], position) - 1
    return {sample.well: sample.sample for sample in sheets[max(last, 0)].samples}
