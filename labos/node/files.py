"""Files of a node: those that are given to an action, and those that it returns.

Both have the SHA-256 of their bytes as id, and are sent over the bus in parts, so that an instrument's PC
needs no shared folder and no second port. Fetched files are stored beside the node, and are verified before
each use.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import msgspec
import structlog

from labos.core.canonical import digest
from labos.errors import DeviceError, NoAnswer, Unreadable
from labos.node.limits import DEPTH_LIMIT, NAME_LIMIT, REPLY_LIMIT, cut, read
from labos.node.protocol import FetchFile, FileReply, FileRequest, KeepFile

if TYPE_CHECKING:
    from labos.ports import Bus

PIECE = 1024 * 1024
"""The most bytes in one part."""
LARGEST = 256 * 1024 * 1024
"""The most bytes of a file."""
STALLED_S = 0.2
"""The pause after a part after which no more bytes had arrived (seconds)."""

_log = structlog.get_logger(__name__)
_encode = msgspec.json.Encoder().encode
_reply = msgspec.json.Decoder(FileReply)


class Attachment(msgspec.Struct, frozen=True):
    """A file within an action's result. ``content`` is its bytes, or the path of the file. The log has
    ``{"file": name, "sha256": …, "bytes": …}`` instead; the lab gets the file before the result."""

    name: str
    content: bytes | Path


class Files:
    """A node's access to the lab's files. ``folder`` is the folder for fetched files."""

    def __init__(self, bus: Bus, key: str, folder: Path, *, timeout_s: float = 10.0) -> None:
        self._bus, self._key, self._folder, self._timeout_s = bus, key, folder, timeout_s

    async def fetch(self, sha256: str, name: str) -> Path:
        """The file of that digest, under its own name. Raises DeviceError (nothing moved) if the lab has no
        such file, and waits for a lab that is away."""
        path = self._folder / sha256[:16] / _simplify_name(name)
        if await asyncio.to_thread(_is_whole, path, sha256):
            return path
        data = bytearray()
        while True:
            reply = await self._ask(FetchFile(sha256, len(data)))
            if reply.problem:
                raise DeviceError(f"The file {name} cannot be fetched: {reply.problem}", effects="none")
            data += reply.data
            if len(data) >= min(reply.size, LARGEST) or not reply.data:
                break
        if digest(bytes(data)) != sha256:
            raise DeviceError(
                f"The file {name} is not the one that the run needs: its SHA-256 differs.", effects="none"
            )
        try:
            await asyncio.to_thread(_write, path, bytes(data))
        except OSError as error:
            raise DeviceError(
                f"The file {cut(name, NAME_LIMIT)} cannot be stored beside the node ({error.strerror}).",
                effects="none",
            ) from error
        return path

    async def send(self, attachment: Attachment) -> dict[str, Any]:
        """Send a file to the lab; returns its reference for the result. Waits for a lab that is away. Raises
        DeviceError (all was done) if the lab does not accept the file."""
        data = await _read_content(attachment)
        if len(data) > LARGEST:
            raise DeviceError(
                f"The file {attachment.name} has {len(data)} bytes; {LARGEST} are allowed.", effects="all"
            )
        name = digest(data)
        sent: int | None = None  # the lab has not yet answered how many bytes it has
        while sent is None or sent < len(data):
            piece = data[sent : sent + PIECE] if sent is not None else b""
            reply = await self._ask(KeepFile(name, len(data), sent or 0, piece))
            if reply.problem:
                raise DeviceError(f"The lab did not accept {attachment.name}: {reply.problem}", effects="all")
            if not 0 <= reply.received <= len(data) or (sent is not None and reply.received <= sent):
                _log.warning("file_part_not_taken", name=attachment.name, received=reply.received)
                await asyncio.sleep(STALLED_S)
            sent = min(max(reply.received, 0), len(data))
        return {"file": attachment.name, "sha256": name, "bytes": len(data)}

    async def _ask(self, request: FileRequest) -> FileReply:
        pause = 0.2
        while True:
            try:
                answer = await self._bus.query(self._key, _encode(request), self._timeout_s)
                return read(answer, _reply, limit=REPLY_LIMIT)
            except (NoAnswer, Unreadable) as error:
                _log.warning("file_waits_for_the_lab", why=str(error))
            await asyncio.sleep(pause)
            pause = min(pause * 2, 5.0)


async def hand_over(result: Any, files: Files | None, depth: int = 0) -> Any:
    """A result in which each attachment was sent to the lab and replaced by its reference. Raises
    DeviceError."""
    if depth > DEPTH_LIMIT:
        raise DeviceError(
            "The action was done, but its result cannot be recorded: it is nested deeper than "
            f"{DEPTH_LIMIT} levels.",
            effects="all",
        )
    match result:
        case Attachment():
            if files is None:
                raise DeviceError(f"There is no lab to receive the file {result.name}.", effects="all")
            return await files.send(result)
        case dict():
            return {key: await hand_over(value, files, depth + 1) for key, value in result.items()}
        case list() | tuple():
            return [await hand_over(value, files, depth + 1) for value in result]
    return result


async def _read_content(attachment: Attachment) -> bytes:
    """Raises DeviceError (all was done)."""
    if isinstance(attachment.content, bytes):
        return attachment.content
    try:
        return await asyncio.to_thread(attachment.content.read_bytes)
    except OSError as error:
        raise DeviceError(
            f"The action was done, but its file {cut(attachment.name, NAME_LIMIT)} cannot be read "
            f"({error.strerror}).",
            effects="all",
        ) from error


def _simplify_name(name: str) -> str:
    """The last part of a file's name, in a form that is valid on every system. A long name is shortened at
    its beginning, because the end shows the kind of file."""
    last = PurePosixPath(name.replace("\\", "/")).name
    short = last.encode("utf-8", "replace")[-NAME_LIMIT:].decode("utf-8", "ignore")
    return re.sub(r"[^\w.\- ]", "_", short).strip(". ") or "file"


def _is_whole(path: Path, sha256: str) -> bool:
    try:
        return digest(path.read_bytes()) == sha256
    except OSError:
        return False


def _write(path: Path, data: bytes) -> None:
    """Write a complete file or none. No sync is needed, because nothing depends on it after a crash."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(data)
        os.replace(beside, path)
    finally:
        with contextlib.suppress(FileNotFoundError):
            beside.unlink()
