"""What the store keeps in the lab's folder, outside the database: a key, a note of the log's end, and which
words were erased.

The key seals snapshots: somebody who can write to the database, but not read the lab's folder, cannot make a
state that the kernel believes. The note says how far the log has reached, so that a database that lost its
tail shows: SQLite drops the rest of a damaged write-ahead log without a word. It is written after each commit
and synced now and then, so it may be behind the log, never before it. It can only say that the log was once
longer; what follows from that, the kernel decides."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Mapping
from pathlib import Path

import msgspec
import structlog

from labos.core.canonical import encode_canonical
from labos.core.seals import add_seal, check_seal
from labos.ports import Head
from labos.private import create_file, make_folder, sync_folder, tighten
from labos.store._erasures import ERASURES, Erased, add_erasures, read_erasures

KEY_FILE = "labos.key"
END_FILE = "labos.head"
END_BYTES = 512
"""The note is always so long, so that a shorter one leaves nothing of a longer one behind."""

SYNC_EVERY = 1000
"""Commits after which the note is synced."""

_KEY = re.compile(rb"[0-9a-f]{64}\s*")
SEAL = "hmac-sha256:"
"""How the seal of a snapshot begins; older versions of LabOS kept a bare digest there."""

_log = structlog.get_logger(__name__)


class KnownEnd(msgspec.Struct, frozen=True):
    """How far a log has reached: the hash, as hexadecimal digits, that it had at a position."""

    lab: str
    position: int
    hash: str
    seal: str = ""


class HomeFiles:
    """The files in one lab's folder. ``home`` is None for a store that has no such folder: it has no key, so
    it keeps and uses no snapshots, and takes no note of the log's end."""

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
        """Give the lab a key if it has none. Without one, as on a full disk, it goes without snapshots."""
        if self._home is None or self.key():
            return
        path = self._home / KEY_FILE
        try:
            if path.exists():  # what cannot be read is not overwritten: somebody may have a copy to put back
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
        """The references of a lab's words that were erased, and the positions of the events that did it.
        Raises BadInput."""
        file = self._home / ERASURES if self._home is not None else None
        if file is None or not file.exists():
            return {}
        return {each.reference: each.position for each in read_erasures(file) if each.lab == lab}

    def note_erasures(self, lab: str, erased: Mapping[str, int]) -> None:
        """These words were erased, in the database as well. If it cannot be noted, the next start does."""
        if self._home is None or not erased:
            return
        try:
            add_erasures(self._home / ERASURES, (Erased(lab, *each) for each in erased.items()))
        except OSError as error:
            _log.warning("erasures_not_noted", folder=str(self._home), why=str(error))

    # -- the end of the log ------------------------------------------------------------------

    def read_known_end(self) -> KnownEnd | None:
        """What the note says; None if there is none that can be believed."""
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
        """From now on ``note`` writes, but nothing below the position that is known already."""
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
        """The log reaches to there, on disk."""
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
        """The lab works without it; but one witness less can show that the log has lost its end."""
        _log.warning("end_of_log_not_noted", folder=str(self._home), why=str(error))
        handle, self._note = self._note, None
        if handle is not None:
            os.close(handle)


def forget_end(home: Path) -> None:
    """A log is put back from a copy on purpose: how far it once reached is of no more use. Raises OSError."""
    (home / END_FILE).unlink(missing_ok=True)
