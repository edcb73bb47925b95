"""Secrets that programs and browsers show: 256 random bits behind a prefix by which people, and programs that
look for leaked secrets, know what they have found."""

from __future__ import annotations

import hashlib
import secrets

TOKEN, SESSION, HOME = "labos_token_", "labos_session_", "labos_home_"


def make_secret(prefix: str) -> str:
    """43 letters, digits, ``-`` and ``_`` behind the prefix."""
    return prefix + secrets.token_urlsafe(32)


def make_digest(secret: str) -> bytes:
    """What is kept of a secret. It is random, so that no slower hash is needed."""
    return hashlib.sha256(secret.encode()).digest()


def make_id() -> str:
    """The public name of a token: it tells nothing about it."""
    return secrets.token_hex(4)
