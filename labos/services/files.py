"""Files that steps have returned: images, traces, raw data of readers.

A result names a file as ``{"file": name, "sha256": …, "bytes": …}``, at any depth; the file's content is a
blob.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec

from labos.core.actions import ActionReconciled, ActionSucceeded
from labos.errors import NotFound
from labos.ports import LogQuery
from labos.services.catalogue import read_catalogue
from labos.services.log import Log, decode_events

_KINDS = (ActionSucceeded.TYPE, ActionReconciled.TYPE)


class ResultFile(msgspec.Struct, frozen=True):
    """A file in a step's result. ``time`` is when the step ended, by its device's clock if the device
    reported it (UTC ns)."""

    run: str
    step: str
    file: str
    sha256: str
    bytes: int
    time: int


def list_files(log: Log, run: str = "", upto: int | None = None) -> list[ResultFile]:
    """The files in a run's results, or in the results of all runs, oldest first. Raises NotFound for an
    unknown run."""
    names = read_catalogue(log, upto)
    if run and run not in names.runs:
        raise NotFound(f"There is no run {run!r} in this log.", remedy="List them: labos runs --all")
    found: list[ResultFile] = []
    query = LogQuery(streams=(run,) if run else (), types=_KINDS, upto=upto)
    for event, head in decode_events(log.select(query)):
        if isinstance(event, ActionSucceeded | ActionReconciled):
            step = names.find_step(event.run, event.step) if event.run else None
            key = step.key if step is not None else str(event.step)
            ended = getattr(event, "ended_ns", 0) or head.recorded_at
            for file, sha256, size in iterate_files(event.result):
                found.append(ResultFile(event.run, key, file, sha256, size, ended))
    return found


def iterate_files(result: Any) -> Iterator[tuple[str, str, int]]:
    """Name, SHA-256 and bytes of each file in a result."""
    waiting = [result]
    while waiting:
        item = waiting.pop(0)
        if isinstance(item, dict):
            if is_file(item):
                yield item["file"], item["sha256"], item["bytes"]
            else:
                waiting.extend(item.values())
        elif isinstance(item, list | tuple):
            waiting.extend(item)


def is_file(item: Any) -> bool:
    """Whether a part of a result names a file."""
    wanted = {"file": str, "sha256": str, "bytes": int}
    return isinstance(item, dict) and all(isinstance(item.get(name), kind) for name, kind in wanted.items())
