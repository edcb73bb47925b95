"""Segments: parts of the log as files. Each line is one record, byte for byte.

A line is ``{"envelope":…,"hash":"…","payload":…}``, the same as the output of ``labos log --json``. Files
that end in ``.gz`` are compressed. The bytes are those that were hashed, so a file can be verified without a
database.
"""

from __future__ import annotations

import gzip
import hashlib
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec

from labos.core.envelope import Envelope, Record
from labos.errors import BadInput, LogDamaged
from labos.private import open_replacement

_GZIP = b"\x1f\x8b"
_RESTORE = "Use another copy of the file; keep this one."


class _Line(msgspec.Struct):
    envelope: msgspec.Raw
    hash: str
    payload: msgspec.Raw


_line = msgspec.json.Decoder(_Line)
_envelope = msgspec.json.Decoder(Envelope)


def encode_record(record: Record) -> bytes:
    """A record as one line of JSON, its envelope and payload byte for byte."""
    return b'{"envelope":%b,"hash":"%b","payload":%b}' % (
        record.envelope,
        record.hash.hex().encode(),
        record.payload,
    )


def decode_record(line: bytes) -> Record:
    """The record of a line. Raises msgspec.MsgspecError or ValueError for a line that is not a record."""
    found = _line.decode(line)
    envelope = bytes(found.envelope)
    return Record(_envelope.decode(envelope), envelope, bytes(found.payload), bytes.fromhex(found.hash))


def write_segment(path: Path, records: Iterable[Record]) -> tuple[str, Record | None]:
    """Write records to a file, which is synced on return and complete or absent; returns its SHA-256, and the
    last record."""
    with open_replacement(path) as file:
        if path.name.endswith(".gz"):
            # The file contains no time and no name: the same records give the same file.
            with gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0, compresslevel=6) as packed:
                last = _write_lines(packed.write, records)
        else:
            last = _write_lines(file.write, records)
    return digest_file(path), last


def _write_lines(write: Callable[[bytes], object], records: Iterable[Record]) -> Record | None:
    last = None
    for last in records:
        write(encode_record(last) + b"\n")
    return last


def read_segment(path: Path, after: int = 0) -> Iterator[Record]:
    """The records of a file that begins after a position, in order. Raises BadInput if it cannot be opened,
    LogDamaged where a line cannot be read. The chain is not checked."""
    position = after
    try:
        with _open_segment(path) as file:
            for number, line in enumerate(file, 1):
                try:
                    record = decode_record(line)
                except (msgspec.MsgspecError, ValueError) as error:
                    raise LogDamaged(
                        f"{path}:{number}: this is not a record of a log ({error}).",
                        position=position + 1,
                        remedy=_RESTORE,
                    ) from None
                position = record.head.position
                yield record
    except (OSError, EOFError, zlib.error) as error:
        if isinstance(error, (FileNotFoundError, PermissionError, IsADirectoryError)):
            raise BadInput(
                f"{path} cannot be read: {error.strerror}.", remedy="Name a file of records."
            ) from None
        raise LogDamaged(
            f"{path} cannot be read after position {position} ({error}).",
            position=position + 1,
            remedy=_RESTORE,
        ) from None


def _open_segment(path: Path) -> BinaryIO | gzip.GzipFile:
    with path.open("rb") as file:
        packed = file.read(2) == _GZIP
    return gzip.open(path, "rb") if packed else path.open("rb")


def digest_file(path: Path) -> str:
    """The SHA-256 of a file, read in chunks."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
