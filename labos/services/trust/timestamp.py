"""Time stamps (RFC 3161): the statement of an authority that a checkpoint's text existed at a time.

Needs the extra ``timestamp``. The authority's whole answer (DER) is stored, which ``openssl ts -verify``
reads.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import httpx

from labos.errors import BadInput, SystemFailed
from labos.services.trust.places import TIMEOUT_S

_QUERY = {"content-type": "application/timestamp-query"}


def request_stamp(url: str, text: bytes) -> bytes:
    """Ask an authority to stamp a text; returns its answer. Raises SystemFailed, BadInput without the
    extra."""
    try:
        from rfc3161_client import PKIStatus, TimestampRequestBuilder, decode_timestamp_response
    except ImportError:
        raise _make_extra_error() from None
    request = TimestampRequestBuilder().data(text).nonce(nonce=True).cert_request(cert_request=True).build()
    try:
        answer = httpx.post(url, content=request.as_bytes(), headers=_QUERY, timeout=TIMEOUT_S)
        answer.raise_for_status()
        stamp = decode_timestamp_response(answer.content)
        granted = stamp.status in (PKIStatus.GRANTED.value, PKIStatus.GRANTED_WITH_MODS.value)
        fits = granted and stamp.tst_info.nonce == request.nonce
    except (httpx.HTTPError, ValueError) as error:
        raise SystemFailed(
            f"The time stamp authority {url} gave none: {error}.", remedy="Is it up?"
        ) from None
    if not fits:
        raise SystemFailed(
            f"The time stamp authority {url} gave none for this request.", remedy="Name another."
        )
    return bytes(answer.content)


def read_stamp_time(stamp: bytes, text: bytes, roots: Path) -> datetime:
    """The time of a stamp for a text. The stamp's certificate must be signed by one of the certificates in a
    PEM file. Raises BadInput if it is not."""
    try:
        from rfc3161_client import VerificationError, VerifierBuilder, decode_timestamp_response
    except ImportError:
        raise _make_extra_error() from None
    from cryptography.x509 import load_pem_x509_certificates

    try:
        certificates = load_pem_x509_certificates(roots.read_bytes())
        answer = decode_timestamp_response(stamp)
        VerifierBuilder(roots=certificates).build().verify_message(answer, text)
        return answer.tst_info.gen_time.astimezone(UTC)
    except (OSError, ValueError, VerificationError) as error:
        raise BadInput(
            f"The time stamp is not valid: {error}.", remedy=f"Is {roots} the certificate of its authority?"
        ) from None


def _make_extra_error() -> BadInput:
    return BadInput(
        "Time stamps need the package's extra timestamp.", remedy="pip install 'labos-sdl[timestamp]'"
    )
