"""Runs of one workflow that are submitted together, as many in each request as possible."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from labos.client._files import workflow_text

MOST_RUNS = 50
"""The largest number of runs in one request; a test compares it with that of the core."""

MOST_FILES = 200
"""The largest number of files in one request; a test compares it with that of the API."""

MOST_CHARACTERS = 64 * 1024 * 1024
"""Characters of all files of one request, in base64, after which further runs are put into the next
request."""


class BatchRun(NamedTuple):
    """A requested run: the number of its payload, the key of its request, its workflow as ``workflow_text``
    returns it, and its payload."""

    number: int
    key: str
    workflow: Mapping[str, Any]
    payload: Mapping[str, Any]


def list_runs(
    workflow: str | Path | Mapping[str, Any], payloads: Iterable[Mapping[str, Any]], request: str
) -> list[BatchRun]:
    """A run for each payload, with the files that this payload names; their keys begin with ``request``. The
    workflow is read again only if a payload contains other texts than the earlier ones. Raises as
    ``workflow_text``."""
    from labos.spec.references import iterate_texts

    known: dict[frozenset[str], dict[str, Any]] = {}
    found = []
    for number, payload in enumerate(payloads):
        texts = frozenset() if isinstance(workflow, Mapping) else frozenset(iterate_texts(payload))
        if texts not in known:
            known[texts] = workflow_text(workflow, payload)
        found.append(BatchRun(number, f"{request}-{number}", known[texts], payload))
    return found


def cut_into_batches(runs: Sequence[BatchRun]) -> Iterator[list[BatchRun]]:
    """The runs, divided into requests: consecutive runs with the same text, within the limits of a
    request."""
    batch: list[BatchRun] = []
    files: dict[str, str] = {}
    for run in runs:
        merged = {**files, **run.workflow.get("files", {})}
        if batch and not _goes_along(batch, run, files, merged):
            yield batch
            batch, merged = [], dict(run.workflow.get("files", {}))
        batch.append(run)
        files = merged
    if batch:
        yield batch


def _goes_along(
    batch: Sequence[BatchRun], run: BatchRun, files: Mapping[str, str], merged: Mapping[str, str]
) -> bool:
    changed = any(merged[name] != content for name, content in files.items())
    return (
        len(batch) < MOST_RUNS
        and run.number == batch[-1].number + 1
        and run.workflow["text"] == batch[0].workflow["text"]
        and not changed
        and len(merged) <= MOST_FILES
        and sum(map(len, merged.values())) <= MOST_CHARACTERS
    )


def merge_files(batch: Sequence[BatchRun]) -> tuple[dict[str, str], list[list[str]]]:
    """The files of all runs of a request, and the names of each run's files; no names if each run has all
    files."""
    files: dict[str, str] = {}
    for run in batch:
        files |= run.workflow.get("files", {})
    names = [list(run.workflow.get("files", {})) for run in batch]
    return files, [] if all(len(each) == len(files) for each in names) else names
