"""Converts values from and to registers, and checks conditions. A register has 16 bits, the high byte first.
The words of longer numbers may have either order."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from labos.errors import DeviceError
from labos_drivers.plc.mapping import Condition, Point

FORMATS = {
    "int16": ">h",
    "uint16": ">H",
    "int32": ">i",
    "uint32": ">I",
    "float32": ">f",
    "int64": ">q",
    "uint64": ">Q",
    "float64": ">d",
}

PointValue = bool | int | float


def decode(point: Point, words: Sequence[int]) -> PointValue:
    """The value of a point from its bits or words. Raises DeviceError for infinity and NaN."""
    if point.kind == "bool":
        return bool(words[0] >> point.bit & 1) if point.bit is not None else bool(words[0])
    order = words if point.word_order == "big" else list(reversed(words))
    raw = struct.unpack(FORMATS[point.kind], b"".join(word.to_bytes(2, "big") for word in order))[0]
    if not math.isfinite(raw):
        raise DeviceError(
            f"{point.table} {point.address} holds {raw}, which is not a number.", effects="none"
        )
    value = raw * point.scale + point.offset
    return round(value) if point.value_type == "int" else float(value)


def encode(name: str, point: Point, value: PointValue) -> list[int]:
    """The words to write for a value. Raises DeviceError (effects ``none``) if the point cannot have it."""
    if point.kind == "bool":
        return [int(bool(value))]
    if not is_within_limits(point, value):
        low, high = ("…" if limit is None else f"{limit:g}" for limit in (point.minimum, point.maximum))
        raise DeviceError(
            f"{name} cannot be {value:g}{f' {point.unit}' if point.unit else ''}.",
            effects="none",
            remedy=f"It lies between {low} and {high}.",
        )
    raw = (value - point.offset) / point.scale
    try:
        data = struct.pack(FORMATS[point.kind], raw if "float" in point.kind else round(raw))
    except (struct.error, OverflowError) as error:
        raise DeviceError(
            f"{name} cannot be {value:g}: it does not fit into {point.kind}.",
            effects="none",
            remedy="Choose another value, or correct `type` or `scale` in the mapping.",
        ) from error
    words = [int.from_bytes(data[n : n + 2], "big") for n in range(0, len(data), 2)]
    return words if point.word_order == "big" else words[::-1]


def is_within_limits(point: Point, value: PointValue) -> bool:
    low, high = point.minimum, point.maximum
    return (low is None or value >= low) and (high is None or value <= high)


def is_met(condition: Condition, value: PointValue) -> bool:
    """Whether the value of a point meets a condition."""
    if condition.has_no_comparison:
        return bool(value)
    if condition.is_ is not None:
        wanted = condition.is_ if isinstance(condition.is_, list) else [condition.is_]
        return value in wanted
    if condition.near is not None and abs(value - float(condition.near)) > condition.within:
        return False
    low, high = condition.minimum, condition.maximum
    return (low is None or value >= low) and (high is None or value <= high)


def is_undecided(condition: Condition, value: PointValue) -> bool:
    """Whether a value neither meets a condition nor is one of its ``not`` values; false without ``not``."""
    if condition.not_ is None or is_met(condition, value):
        return False
    return value not in (condition.not_ if isinstance(condition.not_, list) else [condition.not_])


def describe_condition(condition: Condition, value: PointValue | None = None) -> str:
    """A text about a condition for people: its ``why``, else its point with ``value`` or with the wanted
    value."""
    if condition.why:
        return condition.why
    shown = value if value is not None else condition.is_ if condition.is_ is not None else "as it is"
    return f"{condition.point} is {str(shown).lower() if isinstance(shown, bool) else shown}"
