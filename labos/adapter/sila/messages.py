"""SiLA's messages: the framework's own, and those that follow from a feature definition (SiLA 2 Part B).

They are made at run time from the server's description. Therefore no code is generated for a device, and none
has to fit the installed protobuf package.
"""

from __future__ import annotations

import base64
import datetime
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from labos.adapter._channels import report_missing_package
from labos.adapter.sila.features import (
    Basic,
    Constrained,
    DataType,
    Element,
    Feature,
    ListOf,
    Named,
    Structure,
)
from labos.errors import DeviceError

FRAMEWORK = "sila2.org.silastandard"

_FRAMEWORK: dict[str, tuple[tuple[str, str, int], ...]] = {
    "String": (("value", "string", 1),),
    "Integer": (("value", "int64", 1),),
    "Real": (("value", "double", 1),),
    "Boolean": (("value", "bool", 1),),
    "Binary": (("value", "bytes", 1), ("binaryTransferUUID", "string", 2)),
    "Timezone": (("hours", "int32", 1), ("minutes", "uint32", 2)),
    "Date": (
        ("day", "uint32", 1),
        ("month", "uint32", 2),
        ("year", "uint32", 3),
        ("timezone", "Timezone", 4),
    ),
    "Time": (
        ("second", "uint32", 1),
        ("minute", "uint32", 2),
        ("hour", "uint32", 3),
        ("timezone", "Timezone", 4),
        ("millisecond", "uint32", 5),
    ),
    "Timestamp": (
        ("second", "uint32", 1),
        ("minute", "uint32", 2),
        ("hour", "uint32", 3),
        ("day", "uint32", 4),
        ("month", "uint32", 5),
        ("year", "uint32", 6),
        ("timezone", "Timezone", 7),
        ("millisecond", "uint32", 8),
    ),
    "Any": (("type", "string", 1), ("payload", "bytes", 2)),
    "CommandExecutionUUID": (("value", "string", 1),),
    "CommandConfirmation": (("commandExecutionUUID", "CommandExecutionUUID", 1),),
    "ExecutionInfo": (("commandStatus", "uint32", 1), ("progressInfo", "Real", 2)),
    "ValidationError": (("parameter", "string", 1), ("message", "string", 2)),
    "DefinedExecutionError": (("errorIdentifier", "string", 1), ("message", "string", 2)),
    "UndefinedExecutionError": (("message", "string", 1),),
    "FrameworkError": (("errorType", "uint32", 1), ("message", "string", 2)),
    "SiLAError": (
        ("validationError", "ValidationError", 1),
        ("definedExecutionError", "DefinedExecutionError", 2),
        ("undefinedExecutionError", "UndefinedExecutionError", 3),
        ("frameworkError", "FrameworkError", 4),
    ),
}
"""The fields that are read or written here: name, type, number. Enumerations are sent as numbers."""

LARGEST_INLINE = 2 * 1024 * 1024
"""Bytes of a binary value within a message; larger ones would need SiLA's binary transfer."""


class Messages:
    """The messages of a server's features, by package and name."""

    def __init__(self, features: Iterable[Feature]) -> None:
        try:
            from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
        except ImportError as error:
            raise report_missing_package(error, "sila") from error
        self._descriptors: Any = descriptor_pb2
        self._class_of: Callable[[Any], Any] = message_factory.GetMessageClass
        self._pool: Any = descriptor_pool.DescriptorPool()
        self._types: dict[str, dict[str, DataType]] = {}
        file = self._make_file("SiLAFramework.proto", FRAMEWORK)
        for name, fields in _FRAMEWORK.items():
            message = file.message_type.add(name=name)
            for field, kind, number in fields:
                self._add_field(message, field, number, kind if kind.islower() else f".{FRAMEWORK}.{kind}")
        self._pool.Add(file)
        for feature in features:
            self._add(feature)

    def _add(self, feature: Feature) -> None:
        self._types[feature.package] = {element.name: element.type for element in feature.types}
        file = self._make_file(f"{feature.package}.proto", feature.package)
        file.dependency.append("SiLAFramework.proto")
        for element in feature.types:
            self._add_message(file.message_type, f"DataType_{element.name}", (element,), feature.package)
        for command in feature.commands:
            for suffix, elements in (
                ("Parameters", command.parameters),
                ("Responses", command.responses),
                ("IntermediateResponses", command.intermediate),
            ):
                self._add_message(file.message_type, f"{command.name}_{suffix}", elements, feature.package)
        for property_ in feature.properties:
            element = Element(property_.name, property_.type)
            self._add_message(file.message_type, f"{property_.method}_Responses", (element,), feature.package)
        self._pool.Add(file)

    def make_framework_message(self, name: str, data: bytes = b"", **fields: Any) -> Any:
        """One of the framework's messages, from its bytes or its fields. Raises ValueError."""
        kind = self._class(FRAMEWORK, name)
        return self._read(kind, data) if data else kind(**fields)

    def encode(
        self, package: str, name: str, elements: tuple[Element, ...], values: Mapping[str, Any]
    ) -> bytes:
        """The bytes of a message. Raises DeviceError (``none``) for a value that does not fit."""
        message = self._class(package, name)()
        for element in elements:
            try:
                self._put(package, message, element.name, element.type, values[element.name])
            except (TypeError, ValueError, KeyError, AttributeError) as error:
                raise DeviceError(
                    f"{element.name} cannot be {values[element.name]!r:.100} ({error}).", effects="none"
                ) from error
        encoded: bytes = message.SerializeToString()
        return encoded

    def decode(self, package: str, name: str, elements: tuple[Element, ...], data: bytes) -> dict[str, Any]:
        """The values in a message. Raises ValueError."""
        message = self._read(self._class(package, name), data)
        try:
            return self._read_values(package, message, elements)
        except RecursionError:
            raise ValueError(f"{name} is nested too deeply") from None

    def _read_values(self, package: str, message: Any, elements: tuple[Element, ...]) -> dict[str, Any]:
        return {element.name: self._get(package, message, element.name, element.type) for element in elements}

    # -- how messages are built --------------------------------------------------------------

    def _make_file(self, name: str, package: str) -> Any:
        return self._descriptors.FileDescriptorProto(name=name, package=package, syntax="proto3")

    def _add_message(
        self, among: Any, name: str, elements: tuple[Element, ...], package: str, within: str = ""
    ) -> None:
        message, full_name = among.add(name=name), f"{within or package}.{name}"
        for number, element in enumerate(elements, 1):
            data_type, repeated = element.type, False
            while isinstance(data_type, Constrained | ListOf):
                repeated = repeated or isinstance(data_type, ListOf)
                data_type = data_type.of
            match data_type:
                case Structure():
                    kind = f"{element.name}_Struct"
                    self._add_message(message.nested_type, kind, data_type.elements, package, full_name)
                    kind = f".{full_name}.{kind}"
                case Named():
                    kind = f".{package}.DataType_{data_type.name}"
                case Basic():
                    kind = f".{FRAMEWORK}.{data_type.name}"
            self._add_field(message, element.name, number, kind, repeated=repeated)

    def _add_field(self, message: Any, name: str, number: int, kind: str, *, repeated: bool = False) -> None:
        field = self._descriptors.FieldDescriptorProto
        label = field.LABEL_REPEATED if repeated else field.LABEL_OPTIONAL
        made = message.field.add(name=name, number=number, label=label)
        if kind.startswith("."):
            made.type, made.type_name = field.TYPE_MESSAGE, kind
        else:
            made.type = getattr(field, f"TYPE_{kind.upper()}")

    def _class(self, package: str, name: str) -> Any:
        return self._class_of(self._pool.FindMessageTypeByName(f"{package}.{name}"))

    def _read(self, kind: Any, data: bytes) -> Any:
        try:
            return kind.FromString(data)
        except Exception as error:  # DecodeError, of whatever implementation of protobuf
            raise ValueError(f"the message is not a {kind.DESCRIPTOR.name}") from error

    # -- values ------------------------------------------------------------------------------

    def _put(self, package: str, message: Any, name: str, data_type: DataType, value: Any) -> None:
        while isinstance(data_type, Constrained):
            data_type = data_type.of
        if isinstance(data_type, ListOf):
            if not isinstance(value, list | tuple):
                raise ValueError("it is not a list")
            for item in value:
                self._fill(package, getattr(message, name).add(), data_type.of, item)
            return
        field = getattr(message, name)
        field.SetInParent()
        self._fill(package, field, data_type, value)

    def _fill(self, package: str, field: Any, data_type: DataType, value: Any) -> None:
        match data_type:
            case Constrained():
                self._fill(package, field, data_type.of, value)
            case Named():
                self._put(package, field, data_type.name, self._types[package][data_type.name], value)
            case Structure():
                for element in data_type.elements:
                    self._put(package, field, element.name, element.type, value[element.name])
            case Basic():
                _FILL[data_type.name](field, value)
            case ListOf():
                raise ValueError(f"there is no type {data_type!r}")

    def _get(self, package: str, message: Any, name: str, data_type: DataType) -> Any:
        while isinstance(data_type, Constrained):
            data_type = data_type.of
        if isinstance(data_type, ListOf):
            return [self._read_value(package, item, data_type.of) for item in getattr(message, name)]
        return self._read_value(package, getattr(message, name), data_type)

    def _read_value(self, package: str, field: Any, data_type: DataType) -> Any:
        match data_type:
            case Constrained():
                return self._read_value(package, field, data_type.of)
            case Named():
                return self._get(package, field, data_type.name, self._types[package][data_type.name])
            case Structure():
                return self._read_values(package, field, data_type.elements)
            case Basic():
                return _READ.get(data_type.name, lambda field: field.value)(field)
            case ListOf():
                raise ValueError(f"there is no type {data_type!r}")


# -- basic types -----------------------------------------------------------------------------


def _fill_plain(kind: type) -> Callable[[Any, Any], None]:
    def fill(field: Any, value: Any) -> None:
        if isinstance(value, bool) != (kind is bool):
            raise ValueError("it is of another type")
        field.value = kind(value) if kind is float else value

    return fill


def _fill_binary(field: Any, value: Any) -> None:
    data = bytes(value) if isinstance(value, bytes | bytearray) else str(value).encode()
    if len(data) > LARGEST_INLINE:
        raise ValueError(f"{len(data)} bytes; {LARGEST_INLINE} can be sent")
    field.value = data


def _fill_date(field: Any, value: Any) -> None:
    day = datetime.date.fromisoformat(str(value))
    field.year, field.month, field.day = day.year, day.month, day.day
    field.timezone.SetInParent()


def _fill_time(field: Any, value: Any) -> None:
    _fill_clock(field, datetime.time.fromisoformat(str(value)))


def _fill_timestamp(field: Any, value: Any) -> None:
    moment = datetime.datetime.fromisoformat(str(value))
    field.year, field.month, field.day = moment.year, moment.month, moment.day
    _fill_clock(field, moment)


def _fill_clock(field: Any, moment: datetime.datetime | datetime.time) -> None:
    """Hours to milliseconds, and the time zone (default: UTC)."""
    field.hour, field.minute, field.second = moment.hour, moment.minute, moment.second
    field.millisecond = moment.microsecond // 1000
    minutes = int((moment.utcoffset() or datetime.timedelta()).total_seconds() // 60)
    field.timezone.SetInParent()
    field.timezone.hours, field.timezone.minutes = int(minutes / 60), abs(minutes) % 60


def _fill_any(field: Any, value: Any) -> None:
    raise ValueError("values of any type cannot be sent")


_FILL: dict[str, Callable[[Any, Any], None]] = {
    "String": _fill_plain(str),
    "Integer": _fill_plain(int),
    "Real": _fill_plain(float),
    "Boolean": _fill_plain(bool),
    "Binary": _fill_binary,
    "Date": _fill_date,
    "Time": _fill_time,
    "Timestamp": _fill_timestamp,
    "Any": _fill_any,
}


def _read_binary(field: Any) -> bytes:
    if field.binaryTransferUUID:
        raise ValueError("a binary value is not part of the message, and is not fetched")
    data: bytes = field.value
    return data


def _read_any(field: Any) -> dict[str, str]:
    return {"type": field.type, "payload": base64.b64encode(field.payload).decode()}


def _show_zone(field: Any) -> str:
    return f"{field.timezone.hours:+03}:{field.timezone.minutes:02}"


def _read_date(field: Any) -> str:
    return f"{field.year:04}-{field.month:02}-{field.day:02}"


def _read_time(field: Any) -> str:
    return f"{field.hour:02}:{field.minute:02}:{field.second:02}.{field.millisecond:03}{_show_zone(field)}"


_READ: dict[str, Callable[[Any], Any]] = {
    "Binary": _read_binary,
    "Any": _read_any,
    "Date": _read_date,
    "Time": _read_time,
    "Timestamp": lambda field: f"{_read_date(field)}T{_read_time(field)}",
}
