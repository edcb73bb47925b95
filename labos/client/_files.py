"""Workflows as text, with the files that they name, for a lab that cannot read this disk."""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from labos.core.ids import local
from labos.errors import BadInput, LabosError, NotFound

LARGEST_FILE = 64 * 1024 * 1024

MOST_USED = 100
"""The largest number of files used by a workflow, directly or through others, that are searched for further
files."""


def workflow_text(
    workflow: str | Path | Mapping[str, Any], payload: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A workflow file, or a packaged workflow by name, with the files beside it that its arguments or the
    payload name. Such a text is returned unchanged. Raises BadInput, NotFound."""
    if isinstance(workflow, Mapping):
        return dict(workflow)
    path = Path(workflow)
    if not path.is_file():
        if path.suffix or len(path.parts) > 1:
            raise NotFound(f"There is no workflow file {str(workflow)!r}.", remedy="Check its path.")
        from labos.spec.library import find_spec

        path = find_spec("workflows", str(workflow))
    from labos.spec.source import MAX_BYTES

    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
        text = raw.decode()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"The workflow {str(workflow)!r} cannot be read: {error}.") from None
    if len(raw) > MAX_BYTES:
        raise BadInput(
            f"The workflow {str(workflow)!r} is larger than {MAX_BYTES // 1024 // 1024} MB.",
            remedy="Keep data in separate files and name them in arguments.",
        )
    return {"text": text, "name": str(path), "files": _encode(_read_files_beside(path, text, payload or {}))}


def campaign_text(campaign: str | Path | Mapping[str, Any]) -> dict[str, Any]:
    """A campaign file with the workflow and the table that it names: both are beside it, or the workflow is a
    packaged one. Such a text is returned unchanged. Raises BadInput, NotFound, SpecError."""
    if isinstance(campaign, Mapping):
        return dict(campaign)
    from labos.spec.campaign import find_beside, find_table_of_campaign, find_workflow_of_campaign

    path = Path(campaign)
    if not path.is_file():
        raise NotFound(f"There is no campaign file {str(campaign)!r}.", remedy="Check its path.")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"The campaign {str(campaign)!r} cannot be read: {error}.") from None
    name = find_workflow_of_campaign(text)
    written = find_beside(path, name)
    source = {
        "text": text,
        "name": str(path),
        "workflow": workflow_text(written if written.is_file() else name),
        "files": {},
    }
    table = find_table_of_campaign(text)
    if table:
        with contextlib.suppress(OSError):  # the lab reports that it is missing, and where it is named
            source["files"] = _encode([(table, find_beside(path, table).read_bytes())])
    return source


def step_text(module: str, action: str, args: Mapping[str, Any]) -> dict[str, Any]:
    """The workflow ``do <module>.<action>`` of one step, with the files of the present folder that
    its arguments name."""
    import yaml

    from labos.spec.references import iterate_texts

    name = f"do {local(module)}.{action}"
    step = {"name": action, "module": module, "action": action, "args": dict(args)}
    try:
        text = yaml.safe_dump({"labos": 1, "name": name, "steps": [step]}, sort_keys=False)
    except yaml.YAMLError as error:
        raise BadInput(f"The arguments of {module}.{action} cannot be written down: {error}.") from None
    return {
        "text": text,
        "name": name,
        "files": _encode(_read_files_in(Path.cwd(), set(iterate_texts(args)))),
    }


def _encode(files: Iterable[tuple[str, bytes]]) -> dict[str, str]:
    return {name: base64.b64encode(content).decode() for name, content in files}


def _read_files_beside(path: Path, text: str, payload: Mapping[str, Any]) -> Iterator[tuple[str, bytes]]:
    from labos.spec.references import iterate_texts
    from labos.spec.source import parse

    try:
        data = parse(text, last_wins=True).data
    except LabosError:
        return  # the lab reports the error and its place
    folder = path.resolve().parent
    texts = {*iterate_texts(data), *iterate_texts(payload)}
    unread, seen = list(_find_used_files(data)), set[str]()
    while unread and len(seen) < MOST_USED:
        name = unread.pop()
        if name in seen:
            continue
        seen.add(name)
        for _, content in _read_files_in(folder, {name}):
            with contextlib.suppress(LabosError):
                inner = parse(content, last_wins=True).data
                texts.update(iterate_texts(inner))
                unread += _find_used_files(inner)
    yield from _read_files_in(folder, texts)


def _read_files_in(folder: Path, names: set[str]) -> Iterator[tuple[str, bytes]]:
    from labos.spec.files import find_logical, is_within

    for written in sorted(names):
        if "\n" in written or len(written) > 255:
            continue
        name = find_logical(written, folder)
        try:
            file = (folder / name).resolve()
            if file.is_file() and file.stat().st_size <= LARGEST_FILE and is_within(file, folder):
                yield name, file.read_bytes()
        except (OSError, ValueError):
            continue


def _find_used_files(data: Mapping[str, Any]) -> Iterator[str]:
    """The files with steps that a workflow uses."""
    steps = data.get("steps")
    for step in steps if isinstance(steps, list) else ():
        if isinstance(step, Mapping) and isinstance(step.get("use"), str):
            yield step["use"]
