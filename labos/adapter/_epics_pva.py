"""PV Access with p4p. p4p repeats an operation on the next connection: if the server dies during a put, p4p
sends the put again when the server is back, and the device would move twice. Because p4p asks for the value
before each send, this module gives the value only once.
"""

from __future__ import annotations

import asyncio
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

READ_S = 5.0


class PvaChannels(Channels):
    """``address`` has the addresses of the servers, ``host`` or ``host:port`` separated by blanks; without
    it, EPICS' own environment variables are used. Arrays of bytes are texts, except those in ``numbers``."""

    def __init__(self, address: str, numbers: frozenset[str] = frozenset()) -> None:
        self._numbers = numbers
        try:
            from p4p.client.asyncio import Context, Disconnected, RemoteError
        except ImportError as error:
            raise report_missing_package(error) from error
        config = {"EPICS_PVA_ADDR_LIST": address, "EPICS_PVA_AUTO_ADDR_LIST": "NO"} if address else None
        # Without `nt` values come as they are on the wire, with their alarms.
        self._context = Context("pva", conf=config, useenv=not address, nt=False)
        self._Disconnected, self._RemoteError = Disconnected, RemoteError
        self._watched: list[Any] = []

    def watch(self, name: str, changed: Callable[[ChannelReading | None], None]) -> None:
        async def pass_on(value: Any) -> None:
            changed(None if isinstance(value, Exception) else self._read_value(name, value))

        self._watched.append(self._context.monitor(name, pass_on, notify_disconnect=True))

    async def get(self, name: str, timeout_s: float) -> ChannelReading:
        return self._read_value(name, await self._fetch(name, timeout_s))

    async def _fetch(self, name: str, timeout_s: float) -> Any:
        """The value now, as it is on the wire. Raises DeviceError (``none``)."""
        try:
            return await asyncio.wait_for(self._context.get(name), timeout_s)
        except (TimeoutError, self._Disconnected, self._RemoteError) as error:
            raise DeviceError(
                f"{name} does not answer ({error or 'no value in time'}).", effects="none"
            ) from error

    async def put(self, name: str, value: Any, *, callback: bool, on: str = "") -> None:
        once = _SinglePut(await self._prepare(name, value))
        try:
            await self._context.put(name, once, wait=callback, get=False)
        except _SecondPut as again:
            raise NoResponse(f"{name}: its server was lost before it answered") from again
        except self._Disconnected as error:
            raise NoResponse(f"{name}: {error}") from error
        except self._RemoteError as error:
            raise DeviceError(f"{name} does not accept {value!r} ({error}).") from error
        except (TypeError, ValueError, KeyError) as error:
            raise DeviceError(f"{name} does not accept {value!r} ({error}).", effects="none") from error

    async def _prepare(self, name: str, value: Any) -> Any:
        """The value to send: an enumeration's label as its number, a text for an array as bytes. Raises
        DeviceError (``none``)."""
        if not isinstance(value, str):
            return value
        current = (await self._fetch(name, READ_S)).value
        if "index" in _list_fields(current):
            return number_of(name, value, list(current.choices))
        if _is_bytes(current):
            import numpy as np

            return np.frombuffer(value.encode() + b"\0", dtype=current.dtype)
        return value

    def _read_value(self, name: str, structure: Any) -> ChannelReading:
        value, label = structure.value, ""
        severity = int(structure.alarm.severity) if "alarm" in _list_fields(structure) else 0
        if _is_bytes(value) and name not in self._numbers:
            text = text_of(value.tobytes())
            if text is not None:
                return ChannelReading(text, severity=severity)
        if "index" in _list_fields(value):
            labels = list(value.choices)
            value = int(value.index)
            label = labels[value] if 0 <= value < len(labels) else ""
        elif hasattr(value, "tolist"):
            value = value.tolist()
        return ChannelReading(value, label, severity)

    async def close(self) -> None:
        for watched in self._watched:
            watched.close()
        self._context.close()


class _SecondPut(Exception):
    """The library is about to send a value for the second time."""


class _SinglePut:
    """Gives the value at the first request only."""

    def __init__(self, value: Any) -> None:
        self._value, self._given = value, False

    def __call__(self, wanted: Any) -> Any:
        if self._given:
            del wanted  # the traceback must not keep it
            raise _SecondPut
        self._given = True
        if "index" in _list_fields(wanted.value):
            wanted.value.index = int(self._value)
        else:
            wanted.value = self._value
        return wanted


def _list_fields(value: Any) -> list[str]:
    return list(value.keys()) if hasattr(value, "keys") else []


def _is_bytes(value: Any) -> bool:
    return getattr(value, "dtype", None) in ("int8", "uint8") and value.ndim == 1
