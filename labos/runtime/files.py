"""The kernel's part of file transfer: it sends the files that runs pin, and receives the files of nodes.

Pieces of a file are put together beside the blobs. The file becomes a blob when it is complete and its digest
equals its name. A node that was interrupted continues where it was.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
from collections import defaultdict
from functools import partial
from pathlib import Path

import msgspec

from labos.clock import SystemClock
from labos.core.canonical import digest
from labos.errors import LabosError, Unreadable
from labos.node.files import LARGEST, PIECE
from labos.node.limits import REPLY_LIMIT, read
from labos.node.protocol import FetchFile, FileReply, FileRequest, KeepFile
from labos.ports import BlobStore

_DIGEST = re.compile("[0-9a-f]{64}")
MOST_ARRIVING = 32
"""The largest number of incomplete files."""
LARGEST_ARRIVING = 2 * 1024 * 1024 * 1024
"""The largest number of bytes of all incomplete files."""
STALE_S = 3600.0
"""An incomplete file is deleted if no further piece of it has come for so long."""
WRONG_BYTES = "its content does not match its SHA-256."
_encode = msgspec.json.Encoder().encode
_request: msgspec.json.Decoder[FileRequest] = msgspec.json.Decoder(FetchFile | KeepFile)


class FileDesk:
    """Answers FileRequests; ``arriving`` is a folder for incomplete files."""

    def __init__(self, blobs: BlobStore, arriving: Path) -> None:
        self._blobs, self._arriving = blobs, arriving
        self._turns: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)

    async def on_request(self, payload: bytes) -> bytes:
        """Answer a request."""
        try:
            request = read(payload, _request, limit=REPLY_LIMIT)
        except Unreadable as error:
            return _encode(FileReply(problem=error.message))
        if not _DIGEST.fullmatch(request.digest):
            return _encode(FileReply(problem=f"{request.digest[:80]!r} is not a SHA-256."))
        turn = self._turns[request.digest]
        try:
            async with turn:  # two nodes may send the same file
                reply = await asyncio.to_thread(self._answer, request)
        except LabosError as error:
            reply = FileReply(problem=str(error))
        except OSError as error:
            reply = FileReply(problem=f"The lab cannot keep files: {error.strerror or error}.")
        if not turn.locked():
            self._turns.pop(request.digest, None)
        return _encode(reply)

    def _answer(self, request: FileRequest) -> FileReply:
        match request:
            case FetchFile() if request.offset < 0:
                return FileReply(problem=f"A file has no byte {request.offset}.")
            case FetchFile():
                data = self._blobs.get(request.digest)
                return FileReply(size=len(data), data=data[request.offset : request.offset + PIECE])
            case KeepFile():
                return self._keep(request)

    def _keep(self, request: KeepFile) -> FileReply:
        if not 0 <= request.size <= LARGEST:
            return FileReply(problem=f"It has {request.size} bytes; {LARGEST} are allowed.")
        if len(request.data) > PIECE:
            return FileReply(problem=f"A piece has {len(request.data)} bytes; {PIECE} are allowed.")
        self._arriving.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = self._arriving / request.digest
        if not path.exists():
            self._make_room()
        with open(path, "ab", opener=partial(os.open, mode=0o600)) as file:
            if request.data and file.tell() == request.offset:
                file.write(request.data[: request.size - request.offset])
            received = file.tell()
        if received < request.size:
            return FileReply(received=received)
        data = path.read_bytes()
        whole = digest(data) == request.digest
        if whole:
            self._blobs.put(data)
        path.unlink()
        return FileReply(received=request.size) if whole else FileReply(problem=WRONG_BYTES)

    def _make_room(self) -> None:
        """Before a new file begins, delete incomplete files without new pieces for long, and the oldest if
        there are too many. A node that was only slow sends its file again."""
        found = []
        for path in self._arriving.iterdir():
            with contextlib.suppress(FileNotFoundError):
                status = path.stat()
                found.append((status.st_mtime, status.st_size, path))
        found.sort(reverse=True)
        size, stale = 0, SystemClock().now_ns() / 1e9 - STALE_S
        for number, (touched, bytes_, path) in enumerate(found, 2):
            size += bytes_
            if touched < stale or number > MOST_ARRIVING or size > LARGEST_ARRIVING:
                path.unlink(missing_ok=True)
