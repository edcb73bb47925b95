"""Large payloads as files named by their SHA-256."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from labos.core.canonical import digest
from labos.errors import LogDamaged, NotFound, StoreUnavailable
from labos.private import make_folder, remove_leftovers, replace_file, sync_folder, tighten

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
            made = make_folder(target.parent)
            if not _holds(target, data):
                replace_file(target, data)
            # Also for a blob that was there: another process may have renamed it only just now.
            for folder in {target.parent, *(folder.parent for folder in made)}:
                sync_folder(folder)
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

    def tidy(self) -> None:
        """What a lab does when it opens: the folder becomes private, and what writers that died left behind
        of blobs that are not whole goes away."""
        tighten([self.path], "the folder of blobs")
        remove_leftovers(self.path, "[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/.*")

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
