"""Runs of one workflow that are submitted together, as many in one request as it takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from labos.client._files import workflow_text

MOST_RUNS = 50
"""Runs of one request; a test compares it with that of the core."""

MOST_FILES = 200
"""Files of one request; a test compares it with that of the API."""

MOST_CHARACTERS = 64 * 1024 * 1024
"""Characters of all files of one request, in base64, from which on further runs go into the next one."""


class BatchRun(NamedTuple):
    """A run that is asked for: the number of its payload, the key of the request for it, its workflow as
    ``workflow_text`` gives it, and its payload."""

    number: int
    key: str
    workflow: Mapping[str, Any]
    payload: Mapping[str, Any]


def workflow_texts(
    workflow: str | Path | Mapping[str, Any], payloads: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """The workflow for each payload, with the files that this one names. It is read again only for a payload
    that has other texts than the ones before. Raises as ``workflow_text``."""
    from labos.spec.references import iterate_texts

    known: dict[frozenset[str], dict[str, Any]] = {}
    found = []
    for payload in payloads:
        texts = frozenset() if isinstance(workflow, Mapping) else frozenset(iterate_texts(payload))
        if texts not in known:
            known[texts] = workflow_text(workflow, payload)
        found.append(known[texts])
    return found


def cut_into_batches(runs: Sequence[BatchRun]) -> Iterator[list[BatchRun]]:
    """The runs as they go into requests: neighbours, with the same text, and no more than a request takes."""
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
    """The files of all runs of a request, and the names of those that each run has; no names where each has
    all of them."""
    files: dict[str, str] = {}
    for run in batch:
        files |= run.workflow.get("files", {})
    names = [list(run.workflow.get("files", {})) for run in batch]
    return files, [] if all(len(each) == len(files) for each in names) else names
