"""The data for a secure session on the bus."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.bus._access import make_access_control
from labos.errors import BadInput
from labos.pki import CertificateEntry, Credentials

SCHEME = "tls/"


class Security(msgspec.Struct, frozen=True):
    """TLS with certificates on both sides. ``members`` are the parties with access, if this session runs the
    bus; otherwise the operator of the bus has this list."""

    credentials: Credentials
    members: tuple[CertificateEntry, ...] = ()

    def make_settings(self, mode: str) -> dict[str, Any]:
        """Zenoh's settings for a session of that mode."""
        of = self.credentials
        tls: dict[str, Any] = {
            "root_ca_certificate": str(of.ca),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
        if mode == "router":
            tls |= {"listen_certificate": str(of.certificate), "listen_private_key": str(of.key)}
        else:
            tls |= {"connect_certificate": str(of.certificate), "connect_private_key": str(of.key)}
        found: dict[str, Any] = {f"transport/link/tls/{name}": value for name, value in tls.items()}
        found["transport/link/protocols"] = ["tls"]
        if mode == "router":
            found["access_control"] = make_access_control(self.members)
        return found


def check_endpoints(endpoints: tuple[str, ...], *, secure: bool) -> None:
    """Raises BadInput for an address of the wrong kind: a secure session connects only with TLS."""
    for endpoint in endpoints:
        if endpoint.startswith(SCHEME) is not secure:
            kind, other = ("secure", "tcp/") if secure else ("not secure", SCHEME)
            raise BadInput(
                f"The address {endpoint} does not fit: this end of the bus is {kind}.",
                remedy=f"Write tls/HOST:PORT and add --secure, or neither; {other} is of the other kind.",
            )
