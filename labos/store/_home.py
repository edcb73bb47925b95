"""The store's files in the lab's folder, outside the database: a key, a note of the log's end, and a list of
erased words.

The key seals snapshots. So an attacker who can write to the database, but cannot read the lab's folder,
cannot make a snapshot that the kernel uses. The note has the last known position of the log. It shows when a
database has lost its end: SQLite drops the rest of a damaged write-ahead log without an error. The note is
written after each commit and synced from time to time, so it may be behind the log, but never ahead of it. It
can only show that the log was longer before; the kernel decides what follows."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import msgspec
import structlog

from labos.core.canonical import encode_canonical
from labos.core.seals import add_seal, check_seal
from labos.errors import BadInput
from labos.ports import Head
from labos.private import FILE, create_file, make_folder, sync_folder, tighten

KEY_FILE = "labos.key"
END_FILE = "labos.head"
END_BYTES = 512
"""The note always has this length, so that a shorter note leaves no rest of a longer one."""

SYNC_EVERY = 1000
"""The note is synced after this number of commits."""

_KEY = re.compile(rb"[0-9a-f]{64}\s*")
SEAL = "hmac-sha256:"
"""The beginning of a snapshot's seal; older versions of LabOS stored a plain digest there."""

ERASURES = "labos.erased"
"""The list of erased words: a restored older copy of the log must not bring them back. It only grows; a torn
last line is cut off."""

_log = structlog.get_logger(__name__)


class Erased(msgspec.Struct, frozen=True):
    """A line of the list: a text of a lab that an event at a position erased. Its salt is deleted, and
    without the salt nothing can be learned from a reference."""

    lab: str
    reference: str
    position: int


_decoder = msgspec.json.Decoder(Erased)


def read_erasures(file: Path) -> Iterator[Erased]:
    """The entries of a list. Raises BadInput for a file that is not such a list."""
    try:
        lines = file.read_bytes().split(b"\n")
    except OSError as error:
        raise BadInput(
            f"{file} cannot be read: {error.strerror}.", remedy="Name a lab's labos.erased."
        ) from None
    for number, line in enumerate(lines[:-1], 1):  # bytes after the last newline are a torn line
        try:
            yield _decoder.decode(line)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise BadInput(
                f"{file}:{number}: this is not a line of a list of erasures ({error}).",
                remedy="Replace it with the copy from a backup.",
            ) from None


def add_erasures(file: Path, erased: Iterable[Erased]) -> None:
    """Append to a list; on return it is synced. Raises OSError."""
    lines = b"".join(msgspec.json.encode(each) + b"\n" for each in erased)
    if not lines:
        return
    is_new = not file.exists()
    handle = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), FILE)
    with os.fdopen(handle, "r+b") as written:
        end = written.seek(0, os.SEEK_END)
        written.seek(0)
        whole = written.read(end).rfind(b"\n") + 1
        written.truncate(whole)
        written.seek(whole)
        written.write(lines)
        written.flush()
        os.fsync(written.fileno())
    if is_new:
        sync_folder(file.parent)


class KnownEnd(msgspec.Struct, frozen=True):
    """The known end of a log: a position, and the hash of the log there (hexadecimal digits)."""

    lab: str
    position: int
    hash: str
    seal: str = ""


class HomeFiles:
    """The files in one lab's folder. ``home`` is None for a store without such a folder. Such a store has no
    key, so it neither stores nor uses snapshots, and keeps no note of the log's end."""

    def __init__(self, home: Path | None) -> None:
        self._home = home
        self._key = b""
        self._said_no_key = False
        self._note: int | None = None
        self._noted = 0
        self._known = 0

    # -- the key -----------------------------------------------------------------------------

    def key(self) -> bytes:
        """The lab's key; empty if it has none, or if it cannot be read."""
        if not self._key:  # another process may have made it meanwhile
            self._key = self._read_key()
        return self._key

    def make_key(self) -> None:
        """Make a key for the lab if it has none. If this fails, as on a full disk, the lab has no
        snapshots."""
        if self._home is None or self.key():
            return
        path = self._home / KEY_FILE
        try:
            # A file that cannot be read is not overwritten: a person may restore it from a copy.
            if path.exists():
                return
            make_folder(self._home)
            with create_file(path, exclusive=True) as file:
                file.write(secrets.token_hex(32).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
            sync_folder(self._home)
        except OSError as error:
            _log.warning("no_key_for_snapshots", file=str(path), why=str(error))

    def _read_key(self) -> bytes:
        if self._home is None:
            return b""
        path = self._home / KEY_FILE
        try:
            tighten([path], "the key of the lab's seals")
            text = path.read_bytes()
        except FileNotFoundError:
            return b""
        except OSError as error:
            return self._no_key(path, str(error))
        if not _KEY.fullmatch(text):
            return self._no_key(path, "it does not hold 64 hexadecimal digits")
        return bytes.fromhex(text.decode().strip())

    def _no_key(self, path: Path, why: str) -> bytes:
        if not self._said_no_key:
            self._said_no_key = True
            _log.warning("key_not_read", file=str(path), why=why)
        return b""

    def seal_snapshot(self, lab: str, position: int, hash_: bytes, fingerprint: str, data: bytes) -> str:
        """The seal of a snapshot; empty without a key."""
        key = self.key()
        if not key:
            return ""
        what = encode_canonical(["labos snapshot", lab, position, hash_.hex(), fingerprint, len(data)])
        mac = hmac.new(key, what, hashlib.sha256)
        mac.update(data)
        return f"{SEAL}{mac.hexdigest()}"

    # -- what was erased ---------------------------------------------------------------------

    def erasures(self, lab: str) -> dict[str, int]:
        """The references of a lab's erased words, and the positions of the erasing events. Raises
        BadInput."""
        file = self._home / ERASURES if self._home is not None else None
        if file is None or not file.exists():
            return {}
        return {each.reference: each.position for each in read_erasures(file) if each.lab == lab}

    def note_erasures(self, lab: str, erased: Mapping[str, int]) -> None:
        """Note erased words, which are also erased in the database. If this fails, the next start does it."""
        if self._home is None or not erased:
            return
        try:
            add_erasures(self._home / ERASURES, (Erased(lab, *each) for each in erased.items()))
        except OSError as error:
            _log.warning("erasures_not_noted", folder=str(self._home), why=str(error))

    # -- the end of the log ------------------------------------------------------------------

    def read_known_end(self) -> KnownEnd | None:
        """The content of the note; None if there is no valid one."""
        if self._home is None:
            return None
        path = self._home / END_FILE
        try:
            found = msgspec.json.decode(path.read_bytes(), type=KnownEnd)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            _log.warning("end_of_log_not_read", file=str(path), why=str(error))
            return None
        if fault := check_seal(found, self.key()):
            _log.warning("end_of_log_not_believed", file=str(path), why=fault)
            return None
        return found

    def begin_notes(self, known: int) -> None:
        """From now on ``note`` writes, but no position below the known one."""
        self._known = known
        if self._home is None or self._note is not None:
            return
        path = self._home / END_FILE
        try:
            tighten([path], "the note of the log's end")
            flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0)
            self._note = os.open(path, flags, 0o600)
        except OSError as error:
            self._give_up(error)

    def note(self, head: Head) -> None:
        """Note that the log on disk ends at this head."""
        if self._note is None or head.position < self._known:
            return
        end = add_seal(KnownEnd(head.lab, head.position, head.hash.hex()), self.key())
        text = msgspec.json.encode(end)
        try:
            os.lseek(self._note, 0, os.SEEK_SET)
            os.write(self._note, text.ljust(END_BYTES - 1) + b"\n")
            self._noted += 1
            if self._noted % SYNC_EVERY == 0:
                os.fsync(self._note)
        except OSError as error:
            self._give_up(error)

    def end_notes(self) -> None:
        """Sync the note and close it."""
        handle, self._note = self._note, None
        if handle is not None:
            try:
                os.fsync(handle)
            except OSError as error:
                self._give_up(error)
            finally:
                os.close(handle)

    def _give_up(self, error: OSError) -> None:
        """The lab works without the note, but one proof less can show that the log has lost its end."""
        _log.warning("end_of_log_not_noted", folder=str(self._home), why=str(error))
        handle, self._note = self._note, None
        if handle is not None:
            os.close(handle)


def forget_end(home: Path) -> None:
    """Delete the note, because a log is restored from a copy on purpose. Raises OSError."""
    (home / END_FILE).unlink(missing_ok=True)
