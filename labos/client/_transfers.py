"""Files that an experiment copies from one place to another, each with an event that has its digest."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import IO, Any
from urllib.parse import urlsplit, urlunsplit

import msgspec

from labos.client._record import ExperimentRecord
from labos.client._replay import Key, ReplayMismatch
from labos.errors import BadInput, LabosError

PIECE = 1024 * 1024
"""Bytes that are copied in one step."""

Place = str | Path | Mapping[str, Any]
"""A file: its path, a URL that fsspec knows (``s3://…``, ``sftp://…``, ``https://…``), or a file of the lab,
as a result names it."""


FOLDERS = {"file", "memory", "sftp", "ssh", "ftp", "smb"}
"""Kinds of places where folders have to be made; elsewhere they are a part of a file's name."""


class Transferred(msgspec.Struct, frozen=True):
    """A file that was transferred: its number of ``bytes`` and its SHA-256, which are the same at both
    places."""

    source: str
    target: str
    sha256: str
    bytes: int


class TransferFailed(LabosError):
    """A file could not be transferred. Nothing about it is recorded in the log."""


def transfer(record: ExperimentRecord, key: Key, source: Place, target: str | Path) -> Transferred:
    """Copy a file, read the copy again, and log the transfer; or return the earlier transfer from the log.
    Raises TransferFailed, ReplayMismatch."""
    request = {"source": show_place(source), "target": show_place(target)}
    known = record.find_note(key)
    if known is None:
        begun = perf_counter()
        digest, size = _copy(record, source, str(target))
        facts = {**request, "sha256": digest, "bytes": size, "seconds": round(perf_counter() - begun, 6)}
        known = record.keep(key, "transfer", Path(urlsplit(request["target"]).path).name or "file", facts)
    return read_transfer(record, key, known["facts"], request)


def read_transfer(
    record: ExperimentRecord, key: Key, facts: Mapping[str, Any], request: Mapping[str, str]
) -> Transferred:
    """A transfer from the log. Raises ReplayMismatch if it differs from ``request``, the present one."""
    recorded = {name: facts[name] for name in request}
    if recorded != request:
        raise ReplayMismatch(record.experiment, key, recorded, request)
    return Transferred(**request, sha256=facts["sha256"], bytes=facts["bytes"])


def show_place(place: Place) -> str:
    """A place in the form for the log: without passwords, and without signatures in a URL."""
    if isinstance(place, Mapping):
        return f"lab:{place.get('sha256', '')}"
    parts = urlsplit(str(place))
    if len(parts.scheme) < 2:  # a path; on Windows, perhaps with a drive
        return str(Path(place).resolve())
    host = parts.netloc.rpartition("@")[2]
    return urlunsplit((parts.scheme, host, parts.path, "", ""))


def _copy(record: ExperimentRecord, source: Place, target: str) -> tuple[str, int]:
    try:
        import fsspec
    except ImportError:
        raise BadInput("fsspec is not installed.", remedy='pip install "labos-sdl[transfer]"') from None
    try:
        filesystem, path = fsspec.core.url_to_fs(target)
        kinds = filesystem.protocol
        is_local = "file" in kinds
        written = f"{path}.part" if is_local else path
        if not FOLDERS.isdisjoint([kinds] if isinstance(kinds, str) else kinds):
            filesystem.makedirs(filesystem._parent(path), exist_ok=True)
        with filesystem.open(written, "wb") as into:
            if isinstance(source, Mapping):
                content = record.file(str(source.get("sha256", "")))
                into.write(content)
                digest, size = hashlib.sha256(content).hexdigest(), len(content)
            else:
                with fsspec.open(str(source), "rb") as out_of:
                    digest, size = _pour(out_of, into)
        with filesystem.open(written, "rb") as back:
            arrived, _ = _pour(back, None)
        if arrived == digest and is_local:
            filesystem.mv(written, path)
    except (OSError, ImportError, ValueError) as error:
        raise TransferFailed(
            f"{show_place(source)} was not transferred to {show_place(target)}: "
            f"{type(error).__name__}: {error}.",
            remedy="The transfer is not in the log; transfer it again.",
        ) from error
    if arrived != digest:
        raise TransferFailed(
            f"{show_place(target)} differs from {show_place(source)}: its SHA-256 is {arrived}, not "
            f"{digest}.",
            remedy="Transfer it again.",
        )
    return digest, size


def _pour(out_of: IO[bytes], into: IO[bytes] | None) -> tuple[str, int]:
    """SHA-256 and size of the content that was read, and written if there is a target."""
    sha256, size = hashlib.sha256(), 0
    while piece := out_of.read(PIECE):
        sha256.update(piece)
        size += len(piece)
        if into is not None:
            into.write(piece)
    return sha256.hexdigest(), size
