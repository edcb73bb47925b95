"""Signed, numbered lists of the parties that may use a bus, on computers without the authority. An older list
is never accepted after a newer one."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

import msgspec

from labos.errors import BadInput
from labos.pki._credentials import CA, MEMBERS, read_members
from labos.pki._party import Members
from labos.private import replace_file

NUMBER = "members.number"
LARGEST = 8 * 1024 * 1024
"""Bytes of a list: 20,000 certificates."""


_turn = Lock()
"""A lock, so that a number that is written late is not lower than the previous one."""


class ReceivedList:
    """The list in a party's folder, which was copied there or came over the bus. Calls block."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / MEMBERS

    def read(self) -> Members:
        """Raises NotFound, and BadInput for a list that is older than an earlier one here, that the authority
        has not signed, or that cannot be read."""
        with _turn:
            found, known = read_members(self.file), self._read_known()
            self._check(found, signed=known > 0)
            if found.number < known:
                raise BadInput(
                    f"{self.file} is list number {found.number}, but list number {known} was already "
                    "here: an older list may allow certificates that were revoked later.",
                    remedy="Copy the newest one from the authority. If the authority itself was put back "
                    f"from an older copy, remove {self.folder / NUMBER} first.",
                )
            if found.number > known:
                self._write(NUMBER, f"{found.number}\n".encode())
            return found

    def offer(self, data: bytes) -> bool:
        """Store a list that came over the bus. Returns whether it is newer than the present one. Raises
        BadInput for a list that the authority has not signed."""
        if len(data) > LARGEST:
            raise BadInput(
                f"A revocation list of {len(data)} bytes was received, which is too long.",
                remedy="Check which programs are on the bus.",
            )
        try:
            found = msgspec.json.decode(data, type=Members)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise BadInput(f"A revocation list was received that cannot be read: {error}.") from None
        with _turn:
            if found.number <= max(self._read_known(), self._find_number()):
                return False
            self._check(found, signed=True)
            self._write(MEMBERS, data)
            self._write(NUMBER, f"{found.number}\n".encode())
        return True

    def _check(self, found: Members, *, signed: bool) -> None:
        """Raises BadInput."""
        from labos.pki._signing import has_signed

        if not found.signature and not signed:
            return
        try:
            authority = (self.folder / CA).read_bytes()
        except OSError as error:
            raise BadInput(f"{self.folder / CA} cannot be read: {error}.") from None
        if not found.signature or not has_signed(authority, found.signed_bytes, found.signature):
            raise BadInput(
                f"List number {found.number} is not signed by the authority of {self.folder / CA}.",
                remedy="Make lists with the authority (labos pki), where its key is.",
            )

    def _read_known(self) -> int:
        """The highest number of the lists that were stored here."""
        file = self.folder / NUMBER
        try:
            return int(file.read_text(encoding="ascii"))
        except FileNotFoundError:
            return 0
        except (OSError, ValueError) as error:
            raise BadInput(
                f"{file} cannot be read: {error}.", remedy="Write the number of the newest list into it."
            ) from None

    def _find_number(self) -> int:
        return read_members(self.file).number if self.file.is_file() else 0

    def _write(self, name: str, data: bytes) -> None:
        """Replace a file completely. Raises BadInput."""
        try:
            replace_file(self.folder / name, data)
        except OSError as error:
            raise BadInput(
                f"{self.folder / name} cannot be written: {error}.",
                remedy="Let the user who runs LabOS write into that folder.",
            ) from None
