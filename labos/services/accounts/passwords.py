"""Passwords: which are accepted, and how they are stored (argon2id).

A hash takes 64 MiB and some 0.2 s: they are computed one at a time, in a thread beside the event loop.
"""

from __future__ import annotations

import asyncio

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from labos.errors import BadInput

SHORTEST, LONGEST = 10, 200


def check_password(password: str, user: str) -> None:
    """Raises BadInput for a password that is too easy to guess, or too long."""
    remedy = f"Use at least {SHORTEST} characters, for example four words."
    if not SHORTEST <= len(password) <= LONGEST:
        raise BadInput(f"The password has {len(password)} characters.", remedy=remedy)
    if password.casefold() == user.casefold() or len(set(password)) < 4:
        raise BadInput("The password is too easy to guess.", remedy=remedy)


class Passwords:
    """Makes and compares hashes, one after the other."""

    def __init__(self) -> None:
        self._hasher = PasswordHasher()
        self._turn = asyncio.Semaphore(1)
        self._nobody = ""

    async def hash(self, password: str) -> str:
        async with self._turn:
            return await asyncio.to_thread(self._hasher.hash, password)

    async def is_right(self, hash_: str, password: str) -> bool:
        """Whether a password belongs to a hash. An empty hash (the user does not exist) takes as long as a
        wrong password."""
        async with self._turn:
            return await asyncio.to_thread(self._compare, hash_, password)

    def is_old(self, hash_: str) -> bool:
        """Whether the hash was computed with other parameters than those of today."""
        return self._hasher.check_needs_rehash(hash_)

    def _compare(self, hash_: str, password: str) -> bool:
        if not hash_ and not self._nobody:
            self._nobody = self._hasher.hash("nobody's password")
        try:
            return self._hasher.verify(hash_ or self._nobody, password) and bool(hash_)
        except (VerificationError, InvalidHashError):
            return False
