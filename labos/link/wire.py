"""A wire carries bytes. It does not know messages, questions or answers."""

from __future__ import annotations

from typing import Protocol

from labos.errors import NotConnected


class Wire(Protocol):
    """A byte stream to one device."""

    @property
    def name(self) -> str:
        """Its name in error messages and transcripts, such as ``serial /dev/ttyUSB0``."""

    @property
    def forgets(self) -> bool:
        """Whether bytes under way are discarded when it is closed and opened again."""

    def open(self) -> None:
        """Raises NotConnected."""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Raises LinkLost."""

    def read(self, timeout_s: float) -> bytes:
        """The received bytes, as soon as there are any; empty when the time is up. Raises LinkLost."""

    def close(self) -> None:
        """Raises nothing."""


def needs(extra: str, error: ImportError) -> NotConnected:
    """The error for a missing package that a link needs."""
    return NotConnected(
        f"The Python package {error.name or extra!r} is missing.",
        remedy=f"Install it with: pip install 'labos-sdl[{extra}]'",
    )
