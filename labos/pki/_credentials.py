"""The credentials of one party: a folder with ``ca.pem``, ``cert.pem`` and ``key.pem``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from labos.errors import BadInput, NotFound
from labos.pki._party import CertificateEntry, Members, PartyIdentity

if TYPE_CHECKING:
    from cryptography import x509

CA, CERTIFICATE, KEY, MEMBERS = "ca.pem", "cert.pem", "key.pem", "members.json"

Stamp = tuple[int, ...]


class Credentials(msgspec.Struct, frozen=True):
    """One party's folder. ``labos pki issue`` makes it, or a person makes it from the files of the site."""

    folder: Path

    @property
    def ca(self) -> Path:
        return self.folder / CA

    @property
    def certificate(self) -> Path:
        return self.folder / CERTIFICATE

    @property
    def key(self) -> Path:
        return self.folder / KEY

    def check(self, now_ns: int) -> None:
        """Raises NotFound if a file is missing, BadInput if the certificate cannot be used."""
        for path in (self.ca, self.certificate, self.key):
            if not path.is_file():
                raise NotFound(
                    f"There is no {path}.",
                    remedy="Issue a certificate where the lab's authority is (labos pki issue), and copy its "
                    "folder here.",
                )
        entry = self.entry()
        if entry.not_after <= now_ns:
            raise BadInput(
                f"The certificate {self.certificate} has expired.",
                remedy="Renew it where the lab's authority is (labos pki renew), and copy its folder here.",
            )
        if entry.not_before > now_ns:
            raise BadInput(
                f"The certificate {self.certificate} is not valid yet.",
                remedy="The clock of this computer is wrong: synchronise it with a time server.",
            )
        if sys.platform != "win32" and self.key.stat().st_mode & 0o077:
            raise BadInput(f"Others may read {self.key}.", remedy=f"chmod 600 {self.key}")

    def identity(self) -> PartyIdentity | None:
        """The party that the certificate is for; None if the site issued it. Raises BadInput."""
        from labos.pki._signing import identity_of

        return identity_of(self._read())

    def entry(self) -> CertificateEntry:
        """The content of the certificate. Raises BadInput."""
        from labos.pki._signing import entry_of

        return entry_of(
            self._read(), self.identity() or PartyIdentity("node"), own=self.identity() is not None
        )

    def stamp(self) -> Stamp:
        """A value that changes whenever a file is replaced."""
        return stamp_of(self.ca, self.certificate, self.key)

    def _read(self) -> x509.Certificate:
        from labos.pki._signing import read_certificate

        try:
            return read_certificate(self.certificate.read_bytes(), str(self.certificate))
        except OSError as error:
            raise BadInput(
                f"The certificate {self.certificate} cannot be read: {error}.",
                remedy="Correct or replace the file.",
            ) from error


def stamp_of(*paths: Path) -> Stamp:
    """A value that changes whenever one of the files is replaced."""
    found: list[int] = []
    for path in paths:
        try:
            status = path.stat()
            found += [status.st_mtime_ns, status.st_ino, status.st_size]
        except OSError:
            found.append(0)
    return tuple(found)


def read_members(path: Path) -> Members:
    """Raises BadInput for a file that cannot be read, NotFound if there is none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Members)
    except FileNotFoundError:
        raise NotFound(
            f"There is no {path}, the access rules of the bus.",
            remedy="labos pki init makes it; labos pki issue bus puts a copy into the folder of the bus.",
        ) from None
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"{path} cannot be read: {error}.", remedy="Copy it again.") from error
