"""What carries bytes, and nothing more: no messages, no questions, no answers."""

from __future__ import annotations

from typing import Protocol

from labos.errors import NotConnected


class Wire(Protocol):
    """A byte stream to one device."""

    @property
    def name(self) -> str:
        """How messages and transcripts call it, as ``serial /dev/ttyUSB0``."""

    @property
    def forgets(self) -> bool:
        """Whether what was under way is gone for good once it has been closed and opened again."""

    def open(self) -> None:
        """Raises NotConnected."""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Raises LinkLost."""

    def read(self, timeout_s: float) -> bytes:
        """What has come, as soon as there is any; empty when the time is up. Raises LinkLost."""

    def close(self) -> None:
        """Raises nothing."""


def needs(extra: str, error: ImportError) -> NotConnected:
    """A package that a link needs is not there."""
    return NotConnected(
        f"The Python package {error.name or extra!r} is missing.",
        remedy=f"Install it with: pip install 'labos-sdl[{extra}]'",
    )
