"""Channel Access with aioca, which uses EPICS' own client library."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from labos.adapter._channels import (
    ChannelReading,
    Channels,
    number_of,
    report_missing_package,
    text_of,
)
from labos.adapter._http import NoResponse
from labos.errors import DeviceError

PUT_FAILED, NO_ACCESS = 160, 376
READ_S = 5.0
STRING_BYTES = 39
"""The largest number of bytes of a text in a record; its end is a NUL (``MAX_STRING_SIZE`` of epicsTypes.h is
40)."""

REFUSED = (PUT_FAILED, NO_ACCESS)
"""``ECA_PUTFAIL`` and ``ECA_NOWTACCESS`` of caerr.h: the IOC has refused."""


class CaChannels(Channels):
    """``address`` has the addresses of the IOCs, ``host`` or ``host:port`` separated by blanks; without it,
    EPICS' own environment variables are used. They are read once in a process. Arrays of characters are
    texts, except those in ``numbers``."""

    def __init__(self, address: str, numbers: frozenset[str] = frozenset()) -> None:
        self._numbers = numbers
        if address:
            os.environ["EPICS_CA_ADDR_LIST"] = address
            os.environ["EPICS_CA_AUTO_ADDR_LIST"] = "NO"
        try:
            import aioca
            from epicscorelibs.ca import cadef
        except ImportError as error:
            raise report_missing_package(error) from error
        self._ca = aioca
        # The error for a name that was just lost is not a CANothing.
        self._gone = (cadef.Disconnected, cadef.CAException)
        self._watched: list[Any] = []

    def watch(self, name: str, changed: Callable[[ChannelReading | None], None]) -> None:
        def pass_on(value: Any) -> None:
            changed(self._read_value(name, value) if getattr(value, "ok", False) else None)

        options: dict[str, Any] = {"notify_disconnect": True, "connect_timeout": 1.0}
        watched = self._ca.camonitor(name, pass_on, format=self._ca.FORMAT_CTRL, **options)
        self._watched.append(watched)

    async def get(self, name: str, timeout_s: float) -> ChannelReading:
        try:
            value = await self._ca.caget(name, format=self._ca.FORMAT_CTRL, timeout=timeout_s)
        except (self._ca.CANothing, *self._gone) as error:
            raise DeviceError(f"{name} does not answer ({error}).", effects="none") from error
        return self._read_value(name, value)

    async def put(self, name: str, value: Any, *, callback: bool, on: str = "") -> None:
        if isinstance(value, bool):
            value = int(value)
        options: dict[str, Any] = {"wait": callback, "timeout": None}
        if isinstance(value, str):
            value, kind = await self._prepare(name, value)
            options |= {"datatype": kind} if kind is not None else {}
        try:
            await self._ca.caput(name, value, **options)
        except self._ca.CANothing as error:
            if error.errorcode in REFUSED:
                effects = "none" if error.errorcode == NO_ACCESS else "unknown"
                raise DeviceError(f"{name} does not accept {value!r} ({error}).", effects=effects) from error
            raise NoResponse(f"{name}: {error}") from error
        except self._gone as error:
            raise NoResponse(f"{name}: {error}") from error
        except (TypeError, ValueError) as error:
            raise DeviceError(f"{name} does not accept {value!r} ({error}).", effects="none") from error

    async def _prepare(self, name: str, text: str) -> tuple[Any, Any]:
        """A text in the form for this record, and its type. Text records have 39 bytes; the client library
        would cut off the rest. Raises DeviceError (``none``)."""
        try:
            info = await self._ca.cainfo(name, timeout=READ_S)
            if info.datatype == self._ca.DBR_ENUM:
                enumeration = await self._ca.caget(name, format=self._ca.FORMAT_CTRL, timeout=READ_S)
                return number_of(name, text, list(enumeration.enums)), None
        except (self._ca.CANothing, *self._gone) as error:
            raise DeviceError(f"{name} does not answer ({error}).", effects="none") from error
        is_array = info.datatype == self._ca.DBR_CHAR and info.count > 1
        most, size = (info.count - 1 if is_array else STRING_BYTES), len(text.encode())
        if size > most:
            raise DeviceError(
                f"{name} takes a text of {most} bytes; this one has {size}: {text[:40]!r}…", effects="none"
            )
        return (text + "\0", self._ca.DBR_CHAR_STR) if is_array else (text, None)

    def _read_value(self, name: str, value: Any) -> ChannelReading:
        is_text = getattr(value, "datatype", None) == self._ca.DBR_CHAR and name not in self._numbers
        severity = int(getattr(value, "severity", 0))
        if is_text and hasattr(value, "tobytes") and (text := text_of(value.tobytes())) is not None:
            return ChannelReading(text, severity=severity)
        plain = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(plain, int | float | str):
            plain = next(kind(plain) for kind in (int, float, str) if isinstance(plain, kind))
        labels = getattr(value, "enums", None)
        label = labels[plain] if labels and isinstance(plain, int) and 0 <= plain < len(labels) else ""
        return ChannelReading(plain, label, severity)

    async def close(self) -> None:
        for watched in self._watched:
            watched.close()
        self._watched.clear()
        self._ca.purge_channel_caches()  # otherwise the library calls into a loop that has ended
