"""Signing in: users and their passwords, tokens of programs, sessions of browsers, identity providers."""

from labos.services.accounts.accounts import (
    HOME,
    SESSION,
    TOKEN,
    Accounts,
    Credential,
    Need,
    allows,
    make_digest,
    make_secret,
)

__all__ = [
    "HOME",
    "SESSION",
    "TOKEN",
    "Accounts",
    "Credential",
    "Need",
    "allows",
    "make_digest",
    "make_secret",
]
