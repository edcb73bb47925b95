"""The kernel's side of files: it gives out what runs pin, and takes what nodes leave behind.

A file that arrives in pieces is put together beside the blobs and becomes one when it is whole and
is what its name says. A node that was cut off goes on where it was.
"""

from __future__ import annotations

import asyncio
import re
from collections import defaultdict
from pathlib import Path

import msgspec

from labos.clock import Clock, SystemClock
from labos.core.canonical import digest
from labos.errors import LabosError, Unreadable
from labos.node.files import LARGEST, PIECE
from labos.node.protocol import FetchFile, FileReply, FileRequest, KeepFile
from labos.ports import BlobStore
from labos.runtime.hearing import read

MOST_ARRIVING = 64
"""Files that arrive in pieces at the same time."""

FORGOTTEN_S = 3600.0
"""A file of which nothing has come for so long is not waited for any more, if room is needed."""

_DIGEST = re.compile("[0-9a-f]{64}")
WRONG_BYTES = "its bytes are not those of its SHA-256."
_encode = msgspec.json.Encoder().encode
_request: msgspec.json.Decoder[FileRequest] = msgspec.json.Decoder(FetchFile | KeepFile)


class FileDesk:
    """Answers FileRequests; ``arriving`` is a folder for files that are not yet whole."""

    def __init__(self, blobs: BlobStore, arriving: Path, clock: Clock | None = None) -> None:
        self._blobs, self._arriving = blobs, arriving
        self._clock = clock or SystemClock()
        self._turns: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)

    async def on_request(self, payload: bytes) -> bytes:
        """Answer a request."""
        try:
            request = read(_request.decode, payload, "Somebody")
        except Unreadable as error:
            return _encode(FileReply(problem=error.message))
        if not _DIGEST.fullmatch(request.digest):
            return _encode(FileReply(problem=f"{request.digest[:80]!r} is not a SHA-256."))
        turn = self._turns[request.digest]
        try:
            async with turn:  # two nodes may hand over the same file
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
        self._arriving.mkdir(parents=True, exist_ok=True)
        path = self._arriving / request.digest
        if not path.exists() and not self._make_room():
            return FileReply(problem=f"{MOST_ARRIVING} files are arriving already; try again later.")
        with path.open("ab") as file:
            if request.data and file.tell() == request.offset:
                file.write(request.data[: max(request.size - request.offset, 0)])
            received = file.tell()
        if received < request.size:
            return FileReply(received=received)
        data = path.read_bytes()
        whole = digest(data) == request.digest
        if whole:
            self._blobs.put(data)
        path.unlink()
        return FileReply(received=request.size) if whole else FileReply(problem=WRONG_BYTES)

    def _make_room(self) -> bool:
        """Whether one more file may begin to arrive. Those of which nothing has come for long are thrown
        away: whoever was cut off begins again."""
        here = list(self._arriving.iterdir())
        if len(here) < MOST_ARRIVING:
            return True
        long_ago = self._clock.now_ns() / 1e9 - FORGOTTEN_S
        old = [path for path in here if path.stat().st_mtime < long_ago]
        for path in old:
            path.unlink(missing_ok=True)
        return bool(old)
