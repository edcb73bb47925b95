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
"""What a blob is called: its SHA-256."""


REMOVING = ".removing"


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
        target = self._find_file(name)
        try:
            made = make_folder(target.parent)
            # First of all it becomes young: then nobody removes it as unused.
            if not (_touch(target) and _holds_data(target, data)):
                replace_file(target, data)
            # Also for a blob that was there: another process may have renamed it only just now.
            for folder in {target.parent, *(folder.parent for folder in made)}:
                sync_folder(folder)
        except OSError as error:
            raise self._make_unavailable_error(error) from error
        return name

    def get(self, digest: str) -> bytes:
        """The bytes of a blob. Raises NotFound if there is none, LogDamaged (position 0) if its
        bytes changed, StoreUnavailable if it cannot be read."""
        if not DIGEST.fullmatch(digest):
            raise NotFound(
                f"{digest!r} is not the name of a blob.", remedy="Give 64 hexadecimal digits of a SHA-256."
            )
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
                continue  # perhaps it is put aside for a moment
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
        """Remove a blob that nothing names, unless it was kept again since ``before`` (UNIX time); whether
        that was done. Raises StoreUnavailable."""
        source, aside = self._find_file(name), self.path / REMOVING / name
        try:
            make_folder(aside.parent)
            if source.stat().st_mtime >= before:
                return False  # a young blob is not put aside at all: its readers would have to look for it
            source.rename(aside)
            if aside.stat().st_mtime >= before:
                aside.rename(source)
                return False
            aside.unlink()
        except FileNotFoundError:
            return False  # somebody has removed it, or keeps it just now
        except OSError as error:
            raise self._make_unavailable_error(error) from error
        return True

    def put_back_removed(self) -> None:
        """What a removal that was broken off has put aside stands where it was. Raises StoreUnavailable."""
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
        """What a lab does when it opens: the folder becomes private, and what writers that died left behind
        of blobs that are not whole goes away."""
        tighten([self.path], "the folder of blobs")
        remove_leftovers(self.path, "[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/.*")

    def _find_file(self, name: str) -> Path:
        return self.path / name[:2] / name[2:4] / name

    def _make_unavailable_error(self, error: OSError) -> StoreUnavailable:
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


def _touch(file: Path) -> bool:
    """Make a file young; whether there is one."""
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
