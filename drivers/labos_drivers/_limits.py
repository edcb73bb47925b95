"""Settings of a lab that replace a driver's defaults: time limits, and the settings of the serial line.

``deadlines:`` in a module's config gives time limits by name, as seconds or as texts such as ``10 min``.
``baudrate``, ``parity``, ``bytesize`` and ``stopbits`` are for a converter, or for a device that is not set
as shipped.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from difflib import get_close_matches
from typing import Annotated, Any, get_args

import msgspec

from labos.link import SerialWire
from labos.link.serial import Parity
from labos.node import Setup
from labos_drivers._refusals import make_refusal

PositiveInt = Annotated[int, msgspec.Meta(gt=0)]
BYTESIZES, STOPBITS = (5, 6, 7, 8), (1, 1.5, 2)


def read_deadlines(setup: Setup, known: Collection[str]) -> dict[str, float]:
    """The time limits (s) by name, from ``deadlines:`` of the config; empty if unset. Raises DeviceError."""
    configured = setup.config.get("deadlines")
    if configured is None:
        return {}
    names = ", ".join(known)
    if not known:
        raise make_refusal(setup.name, "this driver has no `deadlines:` that could be set", "Leave them out.")
    if not isinstance(configured, dict):
        raise make_refusal(
            setup.name, f"`deadlines:` is {configured!r}", f"Write seconds by name, of: {names}."
        )
    for name in configured:
        if name not in known:
            close = get_close_matches(str(name), known, 1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            raise make_refusal(setup.name, f"`deadlines:` has no {name!r}", f"{hint}There are: {names}.")
    return {name: _read_seconds(setup, name, value) for name, value in configured.items()}


def _read_seconds(setup: Setup, name: str, configured: Any) -> float:
    value = _parse_seconds(configured) if isinstance(configured, str) else configured
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise make_refusal(
            setup.name, f"`deadlines: {name}:` is {configured!r}", "Write seconds, or a text as `10 min`."
        )
    return float(value)


def _parse_seconds(text: str) -> Any:
    """The seconds in a text such as ``10 min``; the text itself if it is not a duration."""
    from pydantic import TypeAdapter, ValidationError

    from labos.node.mapping import Seconds

    try:
        return TypeAdapter(Seconds).validate_python(text)
    except ValidationError:
        return text


def make_serial_wire(setup: Setup, port: str, *, baudrate: int = 9600, parity: Parity = "N") -> SerialWire:
    """A serial port with the settings from the config. Those that are not there are as shipped. Raises
    DeviceError."""
    found = read_setting(setup, "baudrate", baudrate, PositiveInt, f"As shipped: {baudrate}.")
    chosen = {
        "parity": _read_choice(setup, "parity", get_args(Parity), parity),
        "bytesize": _read_choice(setup, "bytesize", BYTESIZES, 8),
        "stopbits": _read_choice(setup, "stopbits", STOPBITS, 1),
    }
    return SerialWire(port, baudrate=found, **chosen)


def read_setting(setup: Setup, key: str, usual: Any, kind: Any, remedy: str = "") -> Any:
    """A setting from the config, or ``usual`` if it is not there. msgspec checks that it fits ``kind``, a
    type with limits. Raises DeviceError."""
    configured = setup.config.get(key, usual)
    try:
        return msgspec.convert(configured, kind)
    except msgspec.ValidationError:
        raise make_refusal(setup.name, f"`{key}:` is {configured!r}", remedy) from None


def _read_choice(setup: Setup, key: str, choices: Collection[Any], usual: Any) -> Any:
    configured = setup.config.get(key, usual)
    if isinstance(configured, bool) or configured not in choices:
        names = ", ".join(map(str, choices))
        raise make_refusal(
            setup.name, f"`{key}:` is {configured!r}", f"Write one of {names}. As shipped: {usual}."
        )
    return configured
