"""Keys of a payload that a workflow does not use: typing errors, with which the default would be used without
notice.

The keys that a workflow uses are collected from its whole file and from the files that it uses, including
steps that are left out by ``when``. A key is refused only if it occurs in none of them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from labos.core.expressions import ExpressionError, list_names, parse_expression
from labos.errors import SpecError
from labos.spec.files import FileFinder
from labos.spec.findings import FindingList, suggest_name
from labos.spec.models import RunSteps, StepEntry, WorkflowFile
from labos.spec.references import list_keys
from labos.spec.source import Source, parse
from labos.spec.uses import read_workflow

MOST_FILES = 100
"""The most files, used directly or indirectly by a workflow, that are searched."""


class _TakesAll(Exception):
    """The workflow uses the whole payload, or cannot be read completely."""


def refuse_unused(
    payload: Mapping[str, Any],
    file: WorkflowFile,
    sources: Sequence[Source],
    finder: FileFinder,
    report: FindingList,
) -> None:
    """Report each value of a payload that a workflow does not use. ``sources`` are its file in the original
    and in LabOS' own form."""
    for key, remedy in find_unused(payload, file, sources, finder):
        report.error(
            f"The workflow does not use {key!r} of the payload.", field=f"payload.{key}", remedy=remedy
        )


def find_unused(
    payload: Mapping[str, Any], file: WorkflowFile, sources: Sequence[Source], finder: FileFinder
) -> list[tuple[str, str]]:
    """The keys of a payload that a workflow does not use, each with a suggestion."""
    try:
        taken = sorted(_find_taken(file, sources, finder))
    except _TakesAll:
        return []
    found = [
        (k, v) for k, v in _iterate_values(payload) if not any(_serves_key(name, k, v) for name in taken)
    ]
    return [(key, _suggest(key, taken)) for key, _ in found]


def _suggest(key: str, taken: Sequence[str]) -> str:
    if not taken:
        return "Leave it out: this workflow uses no payload."
    inside = [name for name in taken if name.startswith(f"{key}.") or name.endswith(f".{key}")]
    if inside and not difflib.get_close_matches(key, taken, cutoff=0.9):
        return f"Did you mean {' or '.join(repr(name) for name in inside[:2])}?"
    return suggest_name(key, taken, "key")


def _serves_key(name: str, key: str, value: Any) -> bool:
    """Whether a workflow that uses ``name`` uses the value of a key: the value itself, the table around it,
    or a part of it."""
    if key == name or key.startswith(f"{name}."):
        return True
    return isinstance(value, list | tuple | Mapping) and name.startswith(f"{key}.")


def _iterate_values(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested tables by their full keys."""
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from _iterate_values(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _find_taken(file: WorkflowFile, sources: Sequence[Source], finder: FileFinder) -> set[str]:
    """The keys that a workflow and the files that it uses take. Raises _TakesAll."""
    found: set[str] = set()
    seen: set[str] = set()
    waiting = [(file, list(sources))]
    while waiting:
        file, texts = waiting.pop()
        found |= {str(name) for name in file.parameters}
        for source in texts:
            found |= set(list_keys(source.data))
        entries = [entry for _, entry in file.iterate_entries()]
        for entry in entries:
            for text in (entry.when, entry.expect):
                found |= _list_names_in_condition(text)
        for name in _list_used(file, entries):
            if name not in seen:
                seen.add(name)
                waiting.append(_read(name, finder))
        if len(seen) > MOST_FILES:
            raise _TakesAll
    return found


def _list_names_in_condition(condition: str) -> set[str]:
    """The keys that a condition uses. Raises _TakesAll."""
    try:
        names = list_names(parse_expression(condition)) if condition else []
    except ExpressionError:
        raise _TakesAll from None
    found = set()
    for root, *parts in names:
        if root != "payload":
            continue
        if not parts:
            raise _TakesAll
        found.add(".".join(str(part) for part in parts))
    return found


def _list_used(file: WorkflowFile, entries: Iterable[StepEntry]) -> Iterator[str]:
    if isinstance(file.on_cancel, str):
        yield file.on_cancel
    for entry in entries:
        if entry.use:
            yield entry.use
        if isinstance(entry.on_error, RunSteps) and isinstance(entry.on_error.run, str):
            yield entry.on_error.run


def _read(name: str, finder: FileFinder) -> tuple[WorkflowFile, list[Source]]:
    """A used file. Raises _TakesAll if it cannot be read; another check reports that."""
    content = finder.find(name).content
    if content is None:
        raise _TakesAll
    try:
        source = parse(content, name, last_wins=True)
        form, file = read_workflow(source)
    except SpecError:
        raise _TakesAll from None
    if file is None:
        raise _TakesAll
    return file, [source, form]
