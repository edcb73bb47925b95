"""The parties that may have a certificate, and the data of each certificate."""

from __future__ import annotations

import re
from typing import Literal, get_args
from urllib.parse import quote, unquote

import msgspec

Kind = Literal["kernel", "node", "api", "viewer", "stop", "bus"]
KINDS: tuple[Kind, ...] = get_args(Kind)
SERVERS = ("kernel", "bus")
"""The kinds of parties that may run a bus, to which others connect."""

RENEW_PART = 3
"""A certificate is due for renewal when a third of its validity is left."""

URN = "urn:labos:"

PROCESS_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")
"""The name of an API process: a part of keys on the bus."""


class PartyIdentity(msgspec.Struct, frozen=True):
    """The party for which a certificate is valid. ``name`` is ``workcell/module`` for a node, and a name that
    a person chose for an API process, a viewer or a party that may only stop modules. ``lab`` is the lab's
    id; it is empty for a bus, which may serve several labs."""

    kind: Kind
    name: str = ""
    lab: str = ""

    @property
    def uri(self) -> str:
        """The URI in the certificate."""
        return URN + ":".join(quote(part, safe="") for part in (self.kind, self.lab, self.name))

    @property
    def shown(self) -> str:
        return f"{self.kind} {self.name}" if self.name else self.kind


def parse_identity(uri: str) -> PartyIdentity | None:
    """The identity in a URI; None if there is none."""
    if not uri.startswith(URN):
        return None
    parts = [unquote(part) for part in uri[len(URN) :].split(":")]
    if len(parts) != 3 or parts[0] not in KINDS:
        return None
    return PartyIdentity(parts[0], parts[2], parts[1])


def folder_name(identity: PartyIdentity) -> str:
    """The folder of a party's certificate. A node's is ``rpl.sealer``; the names of others begin with their
    kind."""
    name = identity.name.replace("/", ".")
    return name if identity.kind == "node" else f"{identity.kind}.{name}" if name else identity.kind


class CertificateEntry(msgspec.Struct, frozen=True):
    """A certificate that may be used on the bus, or was revoked. Zenoh knows a party by the certificate's
    ``common_name`` only, so each name is given once: renewal keeps it, and a new certificate after a
    revocation has a new one. Times are UTC nanoseconds. ``own``: issued here, not by the site."""

    identity: PartyIdentity
    common_name: str
    serial: str
    not_before: int
    not_after: int
    addresses: tuple[str, ...] = ()
    own: bool = True
    revoked_at: int = 0
    why: str = ""

    @property
    def names(self) -> set[str]:
        """The names that a person may use for it."""
        return {self.common_name, self.identity.name, folder_name(self.identity)} - {""}

    def is_due(self, now_ns: int) -> bool:
        """Whether it is due for renewal."""
        return self.not_after - now_ns < (self.not_after - self.not_before) // RENEW_PART


class Members(msgspec.Struct, frozen=True):
    """The content of ``members.json``: every certificate that was issued here, or taken over from the site.
    Each list has a higher ``number`` than the previous one. ``signature`` is the authority's signature in
    base64 (ECDSA, SHA-256, over ``signed_bytes``); it is empty on computers without the authority's key."""

    entries: tuple[CertificateEntry, ...] = ()
    number: int = 0
    signature: str = ""

    @property
    def signed_bytes(self) -> bytes:
        return b"labos members 1\n" + msgspec.json.encode(msgspec.structs.replace(self, signature=""))

    @property
    def admitted(self) -> tuple[CertificateEntry, ...]:
        """The certificates that are not revoked."""
        return tuple(entry for entry in self.entries if not entry.revoked_at)

    def find(self, identity: PartyIdentity) -> CertificateEntry | None:
        """The valid certificate of a party."""
        return next((entry for entry in self.admitted if entry.identity == identity), None)
