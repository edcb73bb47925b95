"""What is known of a motion that has begun."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from labos.errors import DeviceError


@contextmanager
def under_way() -> Iterator[None]:
    """A motion has begun: whatever goes wrong from now on, nobody can say that nothing moved. A link that
    fails before a question knows only of that question."""
    try:
        yield
    except DeviceError as error:
        if error.effects == "none":
            error.effects = "unknown"
        raise
