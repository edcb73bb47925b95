"""Secrets of programs and browsers: 256 random bits after a prefix. By the prefix, people and programs that
search for leaked secrets recognise them."""

from __future__ import annotations

import hashlib
import secrets

TOKEN, SESSION, HOME = "labos_token_", "labos_session_", "labos_home_"


def make_secret(prefix: str) -> str:
    """The prefix and 43 letters, digits, ``-`` and ``_``."""
    return prefix + secrets.token_urlsafe(32)


def make_digest(secret: str) -> bytes:
    """The digest that is stored in place of a secret. A secret is random, so no slower hash is needed."""
    return hashlib.sha256(secret.encode()).digest()


def make_id() -> str:
    """The public id of a token; nothing about the token follows from it."""
    return secrets.token_hex(4)
