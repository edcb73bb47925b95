"""Large payloads as files named by their SHA-256."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path

from labos.core.canonical import digest
from labos.errors import LogDamaged, NotFound, StoreUnavailable

DIGEST = re.compile("[0-9a-f]{64}")
"""What a blob is called: its SHA-256."""


class FolderBlobs:
    """Blobs in a local folder (``ab/cd/abcd…``); implements ``labos.ports.BlobStore``.

    Several processes may use one folder. A blob is whole or absent: it is written beside its
    place, synced, then renamed.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path).absolute()

    def put(self, data: bytes) -> str:
        """Keep bytes, synced on return, and return their SHA-256. Keeping the same bytes again
        changes nothing, and mends a file that was damaged. Raises StoreUnavailable."""
        name = digest(data)
        target = self._file(name)
        try:
            made = _make_folders(target.parent)
            if not _holds(target, data):
                _write(target, data)
            # Also for a blob that was there: another process may have renamed it only just now.
            for folder in {target.parent, *(folder.parent for folder in made)}:
                _sync_folder(folder)
        except OSError as error:
            raise self._unavailable(error) from error
        return name

    def get(self, digest: str) -> bytes:
        """The bytes of a blob. Raises NotFound if there is none, LogDamaged (position 0) if its
        bytes changed, StoreUnavailable if it cannot be read."""
        if not DIGEST.fullmatch(digest):
            raise NotFound(
                f"{digest!r} is not the name of a blob.", remedy="Give 64 hexadecimal digits of a SHA-256."
            )
        try:
            data = self._file(digest).read_bytes()
        except FileNotFoundError:
            raise NotFound(
                f"There is no blob {digest} in {self.path}.",
                remedy="Check that the folder of blobs is the one that this log was written with.",
            ) from None
        except OSError as error:
            raise self._unavailable(error) from error
        verify_blob(self.path, digest, data)
        return data

    def names(self) -> Iterator[str]:
        """The digests of all blobs. Raises StoreUnavailable."""
        try:
            for path in sorted(self.path.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*")):
                if DIGEST.fullmatch(path.name):
                    yield path.name
        except OSError as error:
            raise self._unavailable(error) from error

    def _file(self, name: str) -> Path:
        return self.path / name[:2] / name[2:4] / name

    def _unavailable(self, error: OSError) -> StoreUnavailable:
        return StoreUnavailable(
            f"The folder of blobs {self.path} is not available: {error.strerror or error}.",
            remedy="Check its disk and that the user who runs LabOS may write there.",
        )


def verify_blob(where: Path | str, name: str, data: bytes) -> None:
    """Raises LogDamaged if these are not the bytes of that name."""
    if digest(data) != name:
        raise LogDamaged(
            f"The blob {name} in {where} is not what was stored: its bytes changed.",
            position=0,
            remedy="Restore it from a backup.",
        )


def _holds(file: Path, data: bytes) -> bool:
    try:
        return file.stat().st_size == len(data) and file.read_bytes() == data
    except FileNotFoundError:
        return False


def _write(target: Path, data: bytes) -> None:
    """Write, sync, rename. The temporary name is this thread's own."""
    beside = target.with_name(f".{target.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, target)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def _make_folders(folder: Path) -> list[Path]:
    """Create a folder and its parents; returns those that were made, for their names to be synced."""
    missing = []
    while not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    for each in reversed(missing):
        each.mkdir(exist_ok=True)
    return missing


def _sync_folder(folder: Path) -> None:
    """Make the names in a folder durable. Windows neither can nor needs to."""
    if os.name == "nt":  # pragma: no cover
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
