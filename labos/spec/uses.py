"""The uses of modules by workflows: the actions and arguments that they write, and their places."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import takewhile
from pathlib import PurePath
from typing import Any

import msgspec

from labos.errors import SpecError
from labos.spec.choices import expand_lists, is_left_open
from labos.spec.dialects import convert_workcell, convert_workflow, detect_kind
from labos.spec.findings import FindingList
from labos.spec.models import WorkcellFile, WorkflowFile
from labos.spec.references import find_result, list_keys
from labos.spec.source import Source
from labos.spec.validation import validate

_NUMBER = re.compile(r"#\d+$|\[\d+\]$")
"""The suffix of a step's name if several steps have the same name."""


class ResultUse(msgspec.Struct, frozen=True):
    """An argument of a later step that gets these fields of a step's result."""

    module: str
    action: str
    arg: str
    fields: tuple[str, ...]


class Use(msgspec.Struct, frozen=True):
    """A step that uses a module. ``where`` is its file and line; ``result_uses`` are the arguments that read
    its result."""

    module: str
    action: str
    args: dict[str, Any]
    where: str
    result_uses: tuple[ResultUse, ...] = ()


def read_uses(sources: Iterable[Source]) -> list[Use]:
    """The uses of modules by the workflows among these files. Files that cannot be read are left out: another
    check reports them."""
    return [use for source in sources for use in _iterate_uses(source)]


def read_carriers(form: Source, file: WorkcellFile) -> list[Use]:
    """The carriers that a workcell names for steps without a module, in the form of uses by a workflow.
    ``form`` is the table of the file that names them."""
    found = []
    for index, way in enumerate(file.transfers):
        own = [place for place in file.stations if place.startswith(f"{way.module}.")]
        known = [*file.locations.get(way.module, ()), *own]
        ends = [*way.from_[:1], *way.to[:1]] if way.from_ and way.to else known[:2]
        if len(ends) > 1:
            args = {**way.args, way.source: ends[0], way.target: ends[1]}
            where = f"{PurePath(form.file).name}, line {form.place(('transfers', index)).line}"
            found.append(Use(way.module, way.action, args, where))
    return found


def sort_workflows_by_workcell(sources: Sequence[Source]) -> dict[str, list[Source]]:
    """The workflows among these files for each workcell among them, by the workcell's file. A workflow
    belongs to the workcells that it names. A workflow that names none of them belongs to those with its
    modules; if there are several, to the nearest."""
    cells: dict[str, set[str]] = {}
    flows: list[tuple[Source, WorkflowFile]] = []
    for source in sources:
        try:
            kind = detect_kind(source)[0]
            if kind == "workcell":
                cells[source.file] = _list_modules(source)
            elif kind == "workflow" and (file := read_workflow(source)[1]) is not None:
                flows.append((source, file))
        except SpecError:
            continue
    found: dict[str, list[Source]] = {}
    for source, file in flows:
        named = [
            cell
            for cell in cells
            if file.workcell and PurePath(file.workcell).name in (PurePath(cell).name, PurePath(cell).stem)
        ]
        used = {e.module for one in expand_lists(file) for _, e in one.iterate_entries() if e.module}
        most = max((len(used & cells[cell]) for cell in named or cells), default=0)
        fitting = [cell for cell in named or cells if most and len(used & cells[cell]) == most]
        nearest = max((_count_shared(cell, source.file) for cell in fitting), default=0)
        for cell in fitting:
            if _count_shared(cell, source.file) == nearest:
                found.setdefault(cell, []).append(source)
    return found


def _list_modules(source: Source) -> set[str]:
    """The active modules of a workcell. Raises SpecError."""
    form, _ = convert_workcell(source, FindingList(source.file))
    return {
        str(module.get("name"))
        for module in form.data.get("modules", ())
        if isinstance(module, dict) and module.get("active") is not False
    }


def _count_shared(one: str, other: str) -> int:
    """The number of folders that two paths have in common, from the root."""
    pairs = zip(PurePath(one).parts[:-1], PurePath(other).parts[:-1], strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def read_workflow(source: Source) -> tuple[Source, WorkflowFile | None]:
    """A workflow in LabOS' form. Raises SpecError."""
    report = FindingList(source.file)
    form, _ = convert_workflow(source, report)
    return form, validate(WorkflowFile, form, report)


def _iterate_uses(source: Source) -> Iterator[Use]:
    try:
        if detect_kind(source)[0] != "workflow":
            return
        form, file = read_workflow(source)
    except SpecError:
        return
    if file is None:
        return
    result_uses: dict[str, list[ResultUse]] = {}
    for _, entry in file.iterate_entries():
        for arg, value in entry.args.items():
            if (reference := find_result(value)) is not None:
                step, fields = reference
                result_use = ResultUse(entry.module, entry.action, arg, tuple(fields))
                result_uses.setdefault(_NUMBER.sub("", step), []).append(result_use)
    uses: list[Use] = []
    for one in expand_lists(file):
        for path, entry in one.iterate_entries():
            if entry.module and not list_keys([entry.module, entry.action]):
                where = f"{PurePath(source.file).name}, line {form.place(path).line}"
                read = tuple(result_uses.get(entry.name, ()))
                use = Use(entry.module, entry.action, entry.args, where, read)
                if use not in uses and not is_left_open(entry):
                    uses.append(use)
                    yield use
