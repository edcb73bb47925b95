"""What a lab knows better than a driver: how long its device may take, and how its serial line is set.

``deadlines:`` of a module's config gives seconds, or texts as ``10 min``, by name; ``baudrate``, ``parity``,
``bytesize`` and ``stopbits`` are those of a converter or a device that was set otherwise than as shipped.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from difflib import get_close_matches
from typing import Any, get_args

from labos.errors import DeviceError
from labos.link import SerialWire
from labos.link.serial import Parity
from labos.node import Setup

BYTESIZES, STOPBITS = (5, 6, 7, 8), (1, 1.5, 2)


def deadlines_in(setup: Setup, known: Collection[str]) -> dict[str, float]:
    """Seconds by name, as ``deadlines:`` of the config says. Raises DeviceError."""
    told = setup.config.get("deadlines")
    if told is None:
        return {}
    names = ", ".join(known)
    if not known:
        raise _wrong(setup, "this driver has no `deadlines:` that could be set.", "Leave them out.")
    if not isinstance(told, dict):
        raise _wrong(setup, f"`deadlines:` is {told!r}.", f"Write seconds by name, of: {names}.")
    for name in told:
        if name not in known:
            close = get_close_matches(str(name), known, 1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            raise _wrong(setup, f"`deadlines:` has no {name!r}.", f"{hint}There are: {names}.")
    return {name: _seconds(setup, name, value) for name, value in told.items()}


def _seconds(setup: Setup, name: str, told: Any) -> float:
    value = _read(told) if isinstance(told, str) else told
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise _wrong(setup, f"`deadlines: {name}:` is {told!r}.", "Write seconds, or a text as `10 min`.")
    return float(value)


def _read(text: str) -> Any:
    """Seconds of a text; the text itself if it is no duration."""
    from pydantic import TypeAdapter, ValidationError

    from labos.node.mapping import Seconds

    try:
        return TypeAdapter(Seconds).validate_python(text)
    except ValidationError:
        return text


def serial_wire(setup: Setup, port: str, *, baudrate: int = 9600, parity: Parity = "N") -> SerialWire:
    """A port as the device is shipped, but for what the config says. Raises DeviceError."""
    config = setup.config
    found = config.get("baudrate", baudrate)
    if isinstance(found, bool) or not isinstance(found, int) or found <= 0:
        raise _wrong(setup, f"`baudrate:` is {found!r}.", f"As shipped: {baudrate}.")
    chosen = {
        "parity": _one_of(setup, "parity", get_args(Parity), parity),
        "bytesize": _one_of(setup, "bytesize", BYTESIZES, 8),
        "stopbits": _one_of(setup, "stopbits", STOPBITS, 1),
    }
    return SerialWire(port, baudrate=found, **chosen)


def _one_of(setup: Setup, key: str, choices: Collection[Any], usual: Any) -> Any:
    told = setup.config.get(key, usual)
    if isinstance(told, bool) or told not in choices:
        names = ", ".join(map(str, choices))
        raise _wrong(setup, f"`{key}:` is {told!r}.", f"Write one of {names}. As shipped: {usual}.")
    return told


def _wrong(setup: Setup, what: str, remedy: str) -> DeviceError:
    return DeviceError(f"{setup.name}: {what}", effects="none", remedy=remedy)
