"""Values by name: the interface to client libraries for the adapters of EPICS and OPC UA. A put is sent at
most once. Client libraries differ here: p4p sends a put again when the server comes back, so that the
implementation for PV Access has to prevent it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from labos.errors import DeviceError
from labos.spec.signals import Condition

SETTLED = 3
"""How many times in a row a device must report that it is idle before an action without an answer counts as
ended."""

SEVERITIES = ("none", "minor", "major", "invalid")
"""By number."""


class ChannelReading(msgspec.Struct, frozen=True):
    """The reading of a process variable: its value, the label of an enumeration's value, and the severity of
    its alarm (0 none, 1 minor, 2 major, 3 invalid)."""

    value: Any
    label: str = ""
    severity: int = 0

    @property
    def plain(self) -> Any:
        """The label, or the value if it has none."""
        return self.label or self.value


class Channels(Protocol):
    """One protocol's process variables, by their full names."""

    def watch(self, name: str, changed: Callable[[ChannelReading | None], None]) -> None:
        """Report every change; None while no server answers for the name."""

    async def get(self, name: str, timeout_s: float) -> ChannelReading:
        """The value now. Raises DeviceError (``none``)."""

    async def put(self, name: str, value: Any, *, callback: bool, on: str = "") -> None:
        """Send a value once; with ``callback``, return when it has been processed. The name must be
        connected. ``on`` is the object on which a method of OPC UA is called. Raises DeviceError if it was
        refused, Lost if it may have been carried out."""

    def why_silent(self) -> str:
        """The reason why there is no answer, as a sentence, if the server has reported it."""
        return ""

    async def close(self) -> None:
        """Disconnect from all names."""


def is_fulfilled(condition: Condition, reading: ChannelReading) -> bool:
    """Whether a reading fulfils a condition."""
    if condition.is_ is not None:
        return _is_among(reading, condition.is_)
    if not _is_number(reading):
        return False
    if condition.near is not None and abs(reading.value - float(condition.near)) > condition.within:
        return False
    low, high = condition.minimum, condition.maximum
    return (low is None or reading.value >= low) and (high is None or reading.value <= high)


def leaves_open(condition: Condition, reading: ChannelReading) -> bool:
    """Whether a reading neither fulfils nor contradicts a condition: it is not a number where one is needed,
    or not one of the known values."""
    if is_fulfilled(condition, reading):
        return False
    if condition.not_ is not None:
        return not _is_among(reading, condition.not_)
    return condition.is_ is None and not _is_number(reading)


def _is_among(reading: ChannelReading, wanted: Any) -> bool:
    values = wanted if isinstance(wanted, list) else [wanted]
    return reading.value in values or (bool(reading.label) and reading.label in values)


def _is_number(reading: ChannelReading) -> bool:
    return isinstance(reading.value, int | float) and math.isfinite(reading.value)


def text_of(data: bytes) -> str | None:
    """The text in an array of characters, up to the first NUL; None if it is not text."""
    try:
        return data.partition(b"\0")[0].decode()
    except UnicodeDecodeError:
        return None


def number_of(name: str, value: str, labels: list[str]) -> int:
    """The number of an enumeration's label. Raises DeviceError (``none``)."""
    if value not in labels:
        raise DeviceError(f"{name} does not accept {value!r}; it has {', '.join(labels)}.", effects="none")
    return labels.index(value)


def report_missing_package(error: ImportError, extra: str = "epics") -> DeviceError:
    """A client library is not installed."""
    return DeviceError(
        f"The Python package {error.name!r} is missing.",
        effects="none",
        remedy=f"Install it with: pip install 'labos-sdl[{extra}]'",
    )
