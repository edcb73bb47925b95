"""Large payloads as files named by their SHA-256."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from labos.core.canonical import digest
from labos.errors import LogDamaged, NotFound, StoreUnavailable
from labos.private import make_folder, remove_leftovers, replace_file, sync_folder, tighten

DIGEST = re.compile("[0-9a-f]{64}")
"""The name of a blob: its SHA-256."""


REMOVING = ".removing"


class FolderBlobs:
    """Blobs in a local folder (``ab/cd/abcd…``); implements ``labos.ports.BlobStore``.

    Several processes may use one folder. A blob is complete or absent: it is written to a temporary file,
    synced, then renamed.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path).absolute()

    def put(self, data: bytes) -> str:
        """Store bytes, synced on return, and return their SHA-256. Storing the same bytes again changes
        nothing, but repairs a damaged file. Raises StoreUnavailable."""
        name = digest(data)
        target = self._find_file(name)
        try:
            made = make_folder(target.parent)
            # The time of the file is renewed first, so that no other process removes it as unused.
            if not (_touch(target) and _holds_data(target, data)):
                replace_file(target, data)
            # This is also done for an existing blob: another process may have renamed it just now.
            for folder in {target.parent, *(folder.parent for folder in made)}:
                sync_folder(folder)
        except OSError as error:
            raise self._make_unavailable_error(error) from error
        return name

    def get(self, digest: str) -> bytes:
        """The bytes of a blob. Raises NotFound if there is none, LogDamaged (position 0) if its
        bytes changed, StoreUnavailable if it cannot be read."""
        check_name(digest)
        try:
            data = self._read(digest)
        except FileNotFoundError:
            raise NotFound(
                f"There is no blob {digest} in {self.path}.",
                remedy="Check that the folder of blobs is the one that this log was written with.",
            ) from None
        except OSError as error:
            raise self._make_unavailable_error(error) from error
        verify_blob(self.path, digest, data)
        return data

    def _read(self, name: str) -> bytes:
        file, aside = self._find_file(name), self.path / REMOVING / name
        for path in (file, aside):
            try:
                return path.read_bytes()
            except FileNotFoundError:
                continue  # it may be set aside for a moment
        return file.read_bytes()

    def names(self) -> Iterator[str]:
        """The digests of all blobs. Raises StoreUnavailable."""
        try:
            for path in sorted(self.path.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*")):
                if DIGEST.fullmatch(path.name):
                    yield path.name
        except OSError as error:
            raise self._make_unavailable_error(error) from error

    def remove_unused(self, name: str, before: float) -> bool:
        """Remove a blob to which no event refers, unless it was stored again since ``before`` (UNIX time).
        Returns whether it was removed. Raises StoreUnavailable."""
        source, aside = self._find_file(name), self.path / REMOVING / name
        try:
            make_folder(aside.parent)
            if source.stat().st_mtime >= before:
                return False  # a new blob is not set aside at all: its readers would have to search for it
            source.rename(aside)
            if aside.stat().st_mtime >= before:
                aside.rename(source)
                return False
            aside.unlink()
        except FileNotFoundError:
            return False  # another process has removed it, or stores it just now
        except OSError as error:
            raise self._make_unavailable_error(error) from error
        return True

    def put_back_removed(self) -> None:
        """Move blobs back that an interrupted removal has set aside. Raises StoreUnavailable."""
        try:
            for aside in (self.path / REMOVING).glob("*"):
                target = self._find_file(aside.name)
                if target.exists():
                    aside.unlink()
                else:
                    aside.rename(target)
        except OSError as error:
            raise self._make_unavailable_error(error) from error

    def tidy(self) -> None:
        """Clean up when a lab opens: make the folder private, and delete incomplete files of writers that
        died."""
        tighten([self.path], "the folder of blobs")
        remove_leftovers(self.path, "[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/.*")

    def _find_file(self, name: str) -> Path:
        return self.path / name[:2] / name[2:4] / name

    def _make_unavailable_error(self, error: OSError) -> StoreUnavailable:
        return StoreUnavailable(
            f"The folder of blobs {self.path} is not available: {error.strerror or error}.",
            remedy="Check its disk and that the user who runs LabOS may write there.",
        )


def check_name(digest: str) -> None:
    """Raises NotFound for a text that cannot be the name of a blob."""
    if not DIGEST.fullmatch(digest):
        raise NotFound(
            f"{digest!r} is not the name of a blob.", remedy="Give 64 hexadecimal digits of a SHA-256."
        )


def verify_blob(where: Path | str, name: str, data: bytes) -> None:
    """Raises LogDamaged if the bytes do not match the name."""
    if digest(data) != name:
        raise LogDamaged(
            f"The blob {name} in {where} is not what was stored: its bytes changed.",
            position=0,
            remedy="Restore it from a backup.",
        )


def _touch(file: Path) -> bool:
    """Renew the time of a file; returns whether the file exists."""
    try:
        os.utime(file)
    except FileNotFoundError:
        return False
    return True


def _holds_data(file: Path, data: bytes) -> bool:
    try:
        return file.stat().st_size == len(data) and file.read_bytes() == data
    except FileNotFoundError:
        return False
