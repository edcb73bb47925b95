"""A real SiLA 2 server as a process."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from labos.settings import free_port
from tests.foreign.make import ROOT
from tests.support.foreign import ForeignProcess

CERTIFY = """
import sys, uuid, pathlib
from sila2.server.encryption import generate_self_signed_certificate
key, certificate = generate_self_signed_certificate(uuid.uuid4(), sys.argv[1])
pathlib.Path("key.pem").write_bytes(key)
pathlib.Path("certificate.pem").write_bytes(certificate)
"""
"""A certificate as ``sila2`` makes it: for an address."""

CERTIFY_NAME = """
import datetime, pathlib
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
key = ec.generate_private_key(ec.SECP256R1())
name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "SiLA2")])
now = datetime.datetime.now(datetime.timezone.utc)
day = datetime.timedelta(days=1)
certificate = x509.CertificateBuilder(name, name, key.public_key(), 1, now - day, now + day)
plain = serialization.PrivateFormat.TraditionalOpenSSL, serialization.NoEncryption()
pathlib.Path("key.pem").write_bytes(key.private_bytes(serialization.Encoding.PEM, *plain))
signed = certificate.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
pathlib.Path("certificate.pem").write_bytes(signed)
"""
"""One with nothing but the name that SiLA prescribes where nobody has signed."""


class SilaProcess(ForeignProcess):
    """``kind`` is ``sila``, or ``unitelabs`` for the server of another maker. ``encrypted``: with a
    certificate of its own, for ``host``, or for the name SiLA2 if that is empty."""

    says_up = "the server is up"

    def __init__(
        self, folder: Path, kind: str = "sila", *, encrypted: bool = False, host: str = "127.0.0.1"
    ) -> None:
        super().__init__(kind, folder, free_port())
        self.encrypted = encrypted
        if encrypted:
            program = [CERTIFY, host] if host else [CERTIFY_NAME]
            subprocess.run([self.python, "-c", *program], cwd=folder, check=True, timeout=60)

    def command(self) -> list[Path | str]:
        secrets = ["key.pem", "certificate.pem"] if self.encrypted else []
        return [self.python, ROOT / "tests" / "foreign" / f"{self.kind}_node.py", str(self.port), *secrets]

    def config(self, port: int = 0) -> dict[str, Any]:
        """Where it is, for the adapter; ``port`` is that of a line to it."""
        where: dict[str, Any] = {"sila_address": f"127.0.0.1:{port or self.port}"}
        if self.encrypted:
            return {**where, "sila_certificate": str(self.folder / "certificate.pem")}
        return {**where, "sila_insecure": True}
