"""The knowledge about a motion that has begun."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from labos.errors import DeviceError


@contextmanager
def assume_motion() -> Iterator[None]:
    """Assume that a motion has begun: after any later error it is unknown whether something moved. A link
    that fails before a request only knows about that request."""
    try:
        yield
    except DeviceError as error:
        if error.effects == "none":
            error.effects = "unknown"
        raise
