"""Certificates (X.509, EC P-256) and revocation lists, with the cryptography library."""

from __future__ import annotations

import ipaddress
from base64 import b64decode, b64encode
from collections.abc import Sequence
from datetime import UTC, datetime

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID as Usage
from cryptography.x509.oid import NameOID

from labos.errors import BadInput
from labos.pki._party import SERVERS, CertificateEntry, PartyIdentity, parse_identity

DAY_NS = 86_400 * 10**9
BEFORE_NS = 600 * 10**9
"""How long before its issue a certificate becomes valid, because the clocks of instruments' computers are
often slow."""

LONGEST_COMMON_NAME = 64
"""X.509's own limit (RFC 5280, ub-common-name)."""


def make_ca(name: str, now_ns: int, days: int) -> tuple[bytes, bytes]:
    """A certificate authority: (certificate, key), as PEM."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _name(name)
    certificate = (
        _builder(subject, subject, key.public_key(), now_ns, now_ns + days * DAY_NS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_make_key_usage(signs_others=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM), _encode_pem(key)


def make_certificate(
    ca: tuple[bytes, bytes],
    identity: PartyIdentity,
    common_name: str,
    addresses: Sequence[str],
    now_ns: int,
    days: int,
) -> tuple[bytes, bytes]:
    """A certificate and its key, as PEM. Others can connect only to a bus and to a kernel (which may run
    one), at their ``addresses``. Raises BadInput for an impossible address."""
    issuer = read_certificate(ca[0], "the authority's certificate")
    key = ec.generate_private_key(ec.SECP256R1())
    serves = identity.kind in SERVERS
    usages = [Usage.SERVER_AUTH, Usage.CLIENT_AUTH] if serves else [Usage.CLIENT_AUTH]
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(identity.uri)]
    names += [_make_address(address) for address in addresses if serves]
    end_ns = min(now_ns + days * DAY_NS, _convert_to_ns(issuer.not_valid_after_utc))
    certificate = (
        _builder(_name(common_name), issuer.subject, key.public_key(), now_ns, end_ns)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_make_key_usage(signs_others=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.public_key()),  # type: ignore[arg-type]
            critical=False,
        )
        .sign(_key(ca[1]), hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM), _encode_pem(key)


def make_revocation_list(
    ca: tuple[bytes, bytes], revoked: Sequence[CertificateEntry], now_ns: int, days: int
) -> bytes:
    """The list of revoked certificates (X.509 CRL), as PEM."""
    issuer = read_certificate(ca[0], "the authority's certificate")
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(issuer.subject)
        .last_update(_convert_to_time(now_ns))
        .next_update(_convert_to_time(now_ns + days * DAY_NS))
    )
    for entry in revoked:
        one = x509.RevokedCertificateBuilder().serial_number(int(entry.serial, 16))
        builder = builder.add_revoked_certificate(
            one.revocation_date(_convert_to_time(entry.revoked_at)).build()
        )
    return builder.sign(_key(ca[1]), hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def sign(key: bytes, data: bytes) -> str:
    """A signature by the authority's key, in base64."""
    return b64encode(_key(key).sign(data, ec.ECDSA(hashes.SHA256()))).decode()


def has_signed(authority: bytes, data: bytes, signature: str) -> bool:
    """Whether the authority with this certificate made a signature. Raises BadInput if it is not a
    certificate."""
    public = read_certificate(authority, "the authority's certificate").public_key()
    if not isinstance(public, ec.EllipticCurvePublicKey):
        return False
    try:
        public.verify(b64decode(signature, validate=True), data, ec.ECDSA(hashes.SHA256()))
    except (InvalidSignature, ValueError):
        return False
    return True


def read_certificate(pem: bytes, what: str) -> x509.Certificate:
    """Raises BadInput."""
    try:
        return x509.load_pem_x509_certificate(pem)
    except ValueError as error:
        raise BadInput(f"{what} is not a certificate: {error}.", remedy="Give a PEM file.") from error


def identity_of(certificate: x509.Certificate) -> PartyIdentity | None:
    """The party of a certificate, if LabOS issued it."""
    found = map(parse_identity, _list_names(certificate, x509.UniformResourceIdentifier))
    return next((identity for identity in found if identity is not None), None)


def entry_of(certificate: x509.Certificate, identity: PartyIdentity, *, own: bool) -> CertificateEntry:
    """The stored data of a certificate. Raises BadInput if it has no common name."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if not names or not names[0].value:
        raise BadInput(
            "The certificate has no common name (CN), which the bus needs to identify its owner.",
            remedy="Request one with a CN; each key needs its own CN.",
        )
    return CertificateEntry(
        identity,
        str(names[0].value),
        f"{certificate.serial_number:x}",
        _convert_to_ns(certificate.not_valid_before_utc),
        _convert_to_ns(certificate.not_valid_after_utc),
        (*_list_names(certificate, x509.DNSName), *_list_names(certificate, x509.IPAddress)),
        own,
    )


def end_of(certificate: x509.Certificate) -> int:
    """The end of its validity (UTC ns)."""
    return _convert_to_ns(certificate.not_valid_after_utc)


def _list_names(certificate: x509.Certificate, kind: type[x509.GeneralName]) -> list[str]:
    """The alternative names of a kind."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names if isinstance(name, kind)]


def is_key_of(certificate: x509.Certificate, key: bytes) -> bool:
    """Whether a private key belongs to the certificate. Raises BadInput if it cannot be read."""
    try:
        private = serialization.load_pem_private_key(key, password=None)
    except (ValueError, TypeError) as error:
        raise BadInput(
            f"The private key cannot be read: {error}.", remedy="Give a PEM file without a password."
        ) from error
    form = serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    return private.public_key().public_bytes(*form) == certificate.public_key().public_bytes(*form)


def is_issued_by(certificate: x509.Certificate, ca: bytes) -> bool:
    """Whether one of the authorities in a PEM file signed it."""
    for issuer in x509.load_pem_x509_certificates(ca):
        try:
            certificate.verify_directly_issued_by(issuer)
        except Exception:  # wrong name, wrong kind of key, wrong signature: each has an exception of its own
            continue
        return True
    return False


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now_ns: int, end_ns: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_convert_to_time(now_ns - BEFORE_NS))
        .not_valid_after(_convert_to_time(end_ns))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _make_key_usage(*, signs_others: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_others,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_others,
        crl_sign=signs_others,
        encipher_only=False,
        decipher_only=False,
    )


def _make_address(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        pass
    try:
        return x509.DNSName(address)
    except ValueError as error:
        raise BadInput(
            f"{address!r} is not an address: {error}.", remedy="Name a host or an IP address."
        ) from error


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _encode_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    key = serialization.load_pem_private_key(pem, password=None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    return key


def _convert_to_time(ns: int) -> datetime:
    return datetime.fromtimestamp(ns // 10**9, UTC)


def _convert_to_ns(time: datetime) -> int:
    return int(time.timestamp()) * 10**9
