"""A lab's own small certificate authority: a folder with a list of the issued certificates.

==================  ==========================================================================
``ca.pem``          the certificate of the authority, for everybody; or that of the site
``ca.key``          its private key; not there if the site issues the certificates
``members.json``    every certificate, whom it is for and whether it was revoked
``crl.pem``         the revoked ones as an X.509 revocation list
``issued/…``        a folder for each party, with what it needs: ``ca.pem``, ``cert.pem``, ``key.pem``, and
                    ``members.json`` for who may run a bus. Parties of a lab are in ``issued/<lab>/<name>``
==================  ==========================================================================
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec

from labos.clock import Clock, SystemClock
from labos.errors import BadInput, NotFound, Refused
from labos.lockfile import FileLock
from labos.pki._credentials import CA, CERTIFICATE, KEY, MEMBERS, Credentials, Stamp, read_members, stamp_of
from labos.pki._party import SERVERS, CertificateEntry, Members, PartyIdentity, folder_name
from labos.private import make_folder, replace_file, sync_folder

CA_KEY, REVOKED = "ca.key", "crl.pem"
MOST_ADDRESSES = 32
"""A container has another host name at each start; without this limit, its certificate would grow with
each."""

CA_DAYS, DAYS = 3650, 365
"""The default validity of an authority and of a certificate."""


class Authority:
    """The authority in one folder."""

    def __init__(self, folder: Path, clock: Clock | None = None) -> None:
        self.folder, self._clock = folder, clock or SystemClock()

    # -- looking -----------------------------------------------------------------------------

    @property
    def exists(self) -> bool:
        return (self.folder / CA).is_file()

    @property
    def issues(self) -> bool:
        """Whether it can issue certificates; otherwise the site issues them."""
        return (self.folder / CA_KEY).is_file()

    @property
    def members_file(self) -> Path:
        return self.folder / MEMBERS

    def read_members(self) -> Members:
        """The list of certificates. Raises NotFound if the authority does not exist, BadInput if the list
        cannot be read."""
        if self.exists and not self.members_file.exists():
            return Members()
        return read_members(self.members_file)

    def stamp(self) -> Stamp:
        """A value that changes with the list of certificates."""
        return stamp_of(self.members_file)

    def find_end(self) -> int:
        """The end of its own certificate (UTC ns). Raises BadInput."""
        from labos.pki._signing import end_of, read_certificate

        return end_of(read_certificate(_read(self.folder / CA), str(self.folder / CA)))

    def list_private_files(self) -> list[Path]:
        """The files that nobody else may read."""
        return [self.folder, self.folder / CA_KEY, *sorted(self.folder.glob(f"issued/**/{KEY}"))]

    def credentials(self, identity: PartyIdentity) -> Credentials:
        """The folder of a party's certificate, which may not exist yet."""
        return Credentials(self.folder / "issued" / identity.lab / folder_name(identity))

    def ensure(self, identity: PartyIdentity, *, addresses: Sequence[str] = ()) -> Credentials:
        """The certificate of a party. It is issued if there is none, and renewed if it is due or does not
        have all ``addresses``. Raises Refused if the site issues certificates and has issued none."""
        entry = self.read_members().find(identity)
        if entry is None:
            self.issue(identity, addresses=addresses)
        elif entry.own and self.issues:
            missing = set(addresses) - set(entry.addresses)
            if missing or entry.is_due(self._clock.now_ns()):
                older = [address for address in entry.addresses if address not in addresses]
                self.renew(entry, addresses=[*addresses, *older][:MOST_ADDRESSES])
        return self.credentials(identity)

    def find(self, name: str) -> CertificateEntry:
        """Find a certificate by the name of its folder, ``workcell/module`` or its CN. A valid one takes
        precedence over a revoked one. Raises NotFound, BadInput if several labs have one of that name."""
        entries = [entry for entry in self.read_members().entries if name in entry.names]
        valid = [entry for entry in entries if not entry.revoked_at]
        if not entries:
            raise NotFound(f"No certificate is called {name!r}.", remedy="labos pki list shows them.")
        if len(valid) > 1:
            known = ", ".join(entry.common_name for entry in valid)
            raise BadInput(
                f"Several certificates are called {name!r}.", remedy=f"Name one by its CN: {known}."
            )
        return (valid or entries)[-1]

    # -- changing ----------------------------------------------------------------------------

    def init(self, name: str, *, days: int = CA_DAYS, site: Path | None = None) -> None:
        """Make the authority, or use the certificate of the authority of the ``site``. Raises Refused if
        there is one, BadInput."""
        from labos.pki._signing import make_ca, read_certificate

        make_folder(self.folder)
        with self._lock():
            if self.exists:
                raise Refused(
                    f"There is already an authority in {self.folder}.",
                    remedy="Issue certificates with it: labos pki issue. Or name another --pki FOLDER.",
                )
            if site is not None:
                ca = _read(site)
                read_certificate(ca, str(site))
            else:
                ca, key = make_ca(name, self._clock.now_ns(), days)
                replace_file(self.folder / CA_KEY, key)
            replace_file(self.folder / CA, ca)
            self._keep(self.read_members())

    def issue(
        self,
        identity: PartyIdentity,
        *,
        addresses: Sequence[str] = (),
        days: int = DAYS,
    ) -> CertificateEntry:
        """Make a certificate for a party that has none. Raises Refused if it has one, or if the site issues
        them, BadInput, NotFound."""
        with self._lock():
            members = self.read_members()
            if members.find(identity) is not None:
                raise Refused(
                    f"There is already a certificate for the {identity.shown}: "
                    f"{self.credentials(identity).folder}.",
                    remedy="Renew it (labos pki renew), or revoke it first (labos pki revoke).",
                )
            entry = self._sign(identity, self._new_name(identity), addresses, days)
            self._keep(Members((*members.entries, entry)))
            return entry

    def issue_all(self, identities: Iterable[PartyIdentity]) -> None:
        """Issue certificates for parties without one, and renew those that are due. Raises Refused if the
        site issues them, BadInput, NotFound."""
        now = self._clock.now_ns()
        with self._lock():
            entries = {entry.common_name: entry for entry in self.read_members().entries}
            changed = False
            for identity in identities:
                had = Members(tuple(entries.values())).find(identity)
                if had is not None and not (had.own and had.is_due(now)):
                    continue
                name = had.common_name if had is not None else self._new_name(identity)
                entries[name] = self._sign(identity, name, had.addresses if had is not None else (), DAYS)
                changed = True
            if changed:
                self._keep(Members(tuple(entries.values())))

    def renew(
        self, entry: CertificateEntry, *, addresses: Sequence[str] = (), days: int = 0
    ) -> CertificateEntry:
        """Make a new key and certificate with the same common name; programs that used the old one have to
        open the bus again. Without ``addresses`` and ``days``, they stay the same. Raises Refused,
        BadInput."""
        with self._lock():
            members = self.read_members()
            if entry.revoked_at:
                raise Refused(
                    f"The certificate of the {entry.identity.shown} is revoked.",
                    remedy="Issue another one: labos pki issue.",
                )
            if not entry.own:
                raise Refused(
                    f"The site issued the certificate of the {entry.identity.shown}.",
                    remedy="Ask the site for a new one with the same CN, and add it: labos pki admit.",
                )
            lasted = round((entry.not_after - entry.not_before) / 86_400e9)
            rest = [e for e in members.entries if e.common_name != entry.common_name]
            where = tuple(addresses) or entry.addresses
            renewed = self._sign(entry.identity, entry.common_name, where, days or max(lasted, 1))
            self._keep(Members((*rest, renewed)))
            return renewed

    def admit(self, identity: PartyIdentity, certificate: Path, key: Path) -> CertificateEntry:
        """Take over a certificate that the site issued: copy it to the party's folder and accept its CN for
        the party. Raises Refused, BadInput."""
        from labos.pki._signing import entry_of, is_issued_by, is_key_of, read_certificate

        cert, private = _read(certificate), _read(key)
        parsed = read_certificate(cert, str(certificate))
        if not is_issued_by(parsed, _read(self.folder / CA)):
            raise BadInput(
                f"{certificate} was not issued by the authority in {self.folder / CA}.",
                remedy="That file has to contain the certificate of the issuer: labos pki init --ca FILE.",
            )
        if not is_key_of(parsed, private):
            raise BadInput(
                f"{key} is not the key of {certificate}.", remedy="Give the two that belong together."
            )
        entry = entry_of(parsed, identity, own=False)
        with self._lock():
            members = self.read_members()
            taken = next((e for e in members.entries if e.common_name == entry.common_name), None)
            if taken is not None and (taken.revoked_at or taken.identity != identity):
                state = "revoked" if taken.revoked_at else "the CN of another certificate"
                raise Refused(
                    f"The CN {entry.common_name!r} is {state} ({taken.identity.shown}).",
                    remedy="Each CN can have only one key: ask the site for a certificate with another CN.",
                )
            rest = tuple(e for e in members.entries if e.identity != identity or e.revoked_at)
            self._hand_out(identity, cert, private)
            self._keep(Members((*rest, entry)))
        return entry

    def revoke(self, entry: CertificateEntry, why: str) -> CertificateEntry:
        """Revoke a certificate, and write the list of revoked ones. Raises Refused."""
        now = self._clock.now_ns()
        with self._lock():
            members = self.read_members()
            if entry.revoked_at:
                raise Refused(f"The certificate of the {entry.identity.shown} is already revoked.")
            ended = msgspec.structs.replace(entry, revoked_at=now, why=why)
            self._keep(
                Members(tuple(ended if e.common_name == entry.common_name else e for e in members.entries))
            )
        return ended

    # -- inside ------------------------------------------------------------------------------

    def _new_name(self, identity: PartyIdentity) -> str:
        from labos.pki._signing import LONGEST_COMMON_NAME

        return f"{folder_name(identity)[: LONGEST_COMMON_NAME - 9]}.{os.urandom(4).hex()}"

    def _sign(
        self, identity: PartyIdentity, common_name: str, addresses: Sequence[str], days: int
    ) -> CertificateEntry:
        from labos.pki._signing import entry_of, make_certificate, read_certificate

        now = self._clock.now_ns()
        cert, key = make_certificate(self._read_ca(), identity, common_name, addresses, now, days)
        entry = entry_of(read_certificate(cert, common_name), identity, own=True)
        self._hand_out(identity, cert, key)
        return entry

    def _read_ca(self) -> tuple[bytes, bytes]:
        if not self.issues:
            raise Refused(
                f"There is no {self.folder / CA_KEY}: the site issues the certificates of this lab.",
                remedy="Ask the site for a certificate, and add it: labos pki admit.",
            )
        return _read(self.folder / CA), _read(self.folder / CA_KEY)

    def _hand_out(self, identity: PartyIdentity, certificate: bytes, key: bytes) -> None:
        """Write a party's folder; the certificate last, so that its key is already there when the certificate
        is found."""
        folder = self.credentials(identity).folder
        make_folder(folder)
        replace_file(folder / CA, _read(self.folder / CA))
        replace_file(folder / KEY, key)
        replace_file(folder / CERTIFICATE, certificate)
        sync_folder(folder)

    def _keep(self, members: Members) -> None:
        """Write the list with the next number. It is signed if the authority's key is here."""
        number = self.read_members().number + 1
        members = Members(members.entries, number)
        if self.issues:
            from labos.pki._signing import make_revocation_list, sign

            signature = sign(self._read_ca()[1], members.signed_bytes)
            members = msgspec.structs.replace(members, signature=signature)
            revoked = [entry for entry in members.entries if entry.revoked_at and entry.own]
            listed = make_revocation_list(self._read_ca(), revoked, self._clock.now_ns(), DAYS)
            replace_file(self.folder / REVOKED, listed)
        text = msgspec.json.format(msgspec.json.encode(members), indent=1) + b"\n"
        for entry in members.admitted:
            if entry.identity.kind in SERVERS:
                replace_file(self.credentials(entry.identity).folder / MEMBERS, text)
        replace_file(self.members_file, text)

    @contextmanager
    def _lock(self) -> Iterator[None]:
        """A lock between commands and the kernel, which renews certificates."""
        if not self.folder.is_dir():
            raise NotFound(f"There is no authority in {self.folder}.", remedy="Make one: labos pki init")
        lock = FileLock(self.folder / ".lock")
        while not lock.acquire(f"process {os.getpid()}"):
            pass  # each attempt takes a while
        try:
            yield
        finally:
            lock.release()


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error}.", remedy="Check its name and its rights.") from error
