"""Seals: a keyed digest of a small document. With the key one can check that the document is unchanged.

HMAC-SHA-256 (RFC 2104) over the canonical JSON of the document with its ``seal`` left empty. Everybody who
can check a seal can also make one. So a seal shows only that the author of the document had the key.
"""

from __future__ import annotations

import hashlib
import hmac
from typing import TypeVar

import msgspec

from labos.core.canonical import encode_canonical

S = TypeVar("S", bound=msgspec.Struct)


def add_seal(document: S, key: bytes) -> S:
    """The document with its ``seal``; unchanged without a key."""
    return msgspec.structs.replace(document, seal=_make_digest(document, key)) if key else document


def check_seal(document: msgspec.Struct, key: bytes) -> str:
    """The fault of a document's seal, in a few words; empty if there is none, or if no key is given."""
    if not key:
        return ""
    seal = str(getattr(document, "seal", ""))
    if not seal:
        return "it has no seal"
    is_ours = hmac.compare_digest(seal, _make_digest(document, key))
    return "" if is_ours else "its seal was not made with this key"


def _make_digest(document: msgspec.Struct, key: bytes) -> str:
    bare = msgspec.structs.replace(document, seal="")  # type: ignore[type-var,unused-ignore]
    return hmac.new(key, encode_canonical(bare), hashlib.sha256).hexdigest()
