"""Reads and writes named points of one PLC. Adjacent points are read in one message."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from labos.errors import DeviceError, LinkError
from labos.link import ModbusLink
from labos_drivers._wired import parse_host_port
from labos_drivers.plc.mapping import Point, Where, Write, fill_argument
from labos_drivers.plc.values import PointValue, decode, encode

ANSWER_S = 2.0
MODBUS_PORT = 502
MOST = {"coil": 2000, "discrete": 2000, "input": 125, "holding": 125}
"""What fits into one answer."""

Span = tuple[Where, int, int]
"""A table, its first address, and how many."""


def make_link(address: str, name: str, config: Mapping[str, Any]) -> ModbusLink:
    """The link for an address: host, ``host:port``, or a serial port or its URL (RTU). Raises DeviceError."""
    unit = int(config.get("unit", 1))
    if os.path.isabs(address) or re.match(r"COM\d+$|socket:|rfc2217:", address):
        settings = {key: config[key] for key in ("baudrate", "parity", "stopbits", "late_s") if key in config}
        return ModbusLink.rtu(address, unit=unit, name=name, **settings)
    return ModbusLink.tcp(*parse_host_port(address, MODBUS_PORT), unit=unit, name=name)


class Points:
    """The points of a mapping, read and written over a link."""

    def __init__(self, link: ModbusLink, points: Mapping[str, Point]) -> None:
        self.link, self._points = link, points

    def read(self, names: Iterable[str]) -> dict[str, PointValue]:
        """The values of points. Each value is read in one message. Two values may come in different messages,
        and thus be from different moments. Raises LinkError, DeviceError."""
        wanted = {name: self._points[name] for name in names}
        spans = _group_spans(wanted.values())
        found: dict[Span, list[int]] = {span: self._read(span) for span in spans}
        values = {}
        for name, point in wanted.items():
            span = next(s for s in spans if _is_within(s, point))
            start = point.address - span[1]
            values[name] = decode(point, found[span][start : start + point.width])
        return values

    def write(self, name: str, value: PointValue) -> None:
        """Write one value, in one message. Raises LinkError, DeviceError."""
        point = self._points[name]
        words = encode(name, point, value)
        if point.table == "coil":
            self.link.write_coils(point.address, [bool(word) for word in words], timeout_s=ANSWER_S)
        else:
            self.link.write_holding(point.address, words, timeout_s=ANSWER_S)

    def write_all(self, writes: Iterable[Write], values: Mapping[str, Any]) -> None:
        """Write several values, one message after the other. Raises LinkError, DeviceError."""
        for write in writes:
            self.write(write.point, fill_argument(write.value, values))

    def _read(self, span: Span) -> list[int]:
        table, first, count = span
        readers: dict[Where, Callable[..., Sequence[int]]] = {
            "coil": self.link.coils,
            "discrete": self.link.discretes,
            "input": self.link.inputs,
            "holding": self.link.holding,
        }
        try:
            return [int(value) for value in readers[table](first, count, timeout_s=ANSWER_S)]
        except LinkError:
            raise
        except DeviceError as error:
            names = ", ".join(name for name, point in self._points.items() if _is_within(span, point))
            words = f"{error.message} The request was for {names}."
            raise DeviceError(words, effects=error.effects, remedy=error.remedy) from error


def _is_within(span: Span, point: Point) -> bool:
    table, first, count = span
    return point.table == table and first <= point.address <= first + count - point.width


def _group_spans(points: Iterable[Point]) -> list[Span]:
    """As few requests as possible for these points. No request covers an address without a point."""
    spans: list[Span] = []
    for point in sorted(points, key=lambda p: (p.table, p.address, p.width)):
        if spans:
            table, first, count = spans[-1]
            end = max(first + count, point.address + point.width)
            if table == point.table and point.address <= first + count and end - first <= MOST[table]:
                spans[-1] = (table, first, end - first)
                continue
        spans.append((point.table, point.address, point.width))
    return spans
