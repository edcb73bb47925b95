"""Values of OPC UA in types that a server defines itself: enumerations, structures, derived types. The
meaning of a number or a table is read from the server's type definitions (OPC UA part 3, 8.14 and 8.40 ff.;
part 5 for ``EnumStrings`` and ``EnumValues``), and never assumed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import enum
from typing import Any

import msgspec

ENUMERATION, STRUCTURE = 29, 22
"""``Enumeration`` and ``Structure``, the base types in the namespace of OPC UA."""

INTEGERS = ("SByte", "Byte", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")


class OpcuaKind(msgspec.Struct, frozen=True):
    """A data type. ``variant`` is the built-in type on the wire (None: the type of the variable's present
    value). ``labels`` are those of an enumeration by number. ``fields`` are those of a structure by name;
    some are ``optional``."""

    data_type: Any
    variant: Any = None
    labels: dict[int, str] = {}
    fields: dict[str, OpcuaKind] = {}
    optional: frozenset[str] = frozenset()


class Types:
    """The data types of a server. ``known`` are those already read; ``ua`` is asyncua's module of that
    name."""

    def __init__(self, client: Any, ua: Any, known: dict[Any, OpcuaKind] | None = None) -> None:
        self._client, self._ua = client, ua
        self._known = {} if known is None else known
        self._loaded = False

    async def find(self, node: Any) -> OpcuaKind:
        """The type of a variable. Raises UaError, OSError, TimeoutError."""
        kind = await self.kind(await node.read_data_type())
        if kind.variant is not None:
            return kind
        held = await node.read_data_value(raise_on_bad_status=False)
        return msgspec.structs.replace(kind, variant=held.Value.VariantType if held.Value else None)

    async def kind(self, data_type: Any) -> OpcuaKind:
        """A data type by its node id. Raises as ``of`` does."""
        if data_type not in self._known:
            self._known[data_type] = await self._read(data_type)
        return self._known[data_type]

    async def _read(self, data_type: Any) -> OpcuaKind:
        from asyncua.common.ua_utils import get_base_data_type

        node = self._client.get_node(data_type)
        base = (await get_base_data_type(node)).nodeid.Identifier
        if base == ENUMERATION:
            return OpcuaKind(data_type, self._ua.VariantType.Int32, labels=await self._read_labels(node))
        if base == STRUCTURE and data_type != self._ua.NodeId(STRUCTURE):
            return await self._read_structure(node)
        if base in (24, 26, 27, 28):  # BaseDataType, Number, Integer, UInteger: the value itself says which
            return OpcuaKind(data_type)
        return OpcuaKind(data_type, self._ua.VariantType(base))

    async def _read_labels(self, node: Any) -> dict[int, str]:
        """An enumeration's labels, from any of the places where a server may have them."""
        missing = self._ua.UaStatusCodeError
        with contextlib.suppress(missing):
            labels = await (await node.get_child("0:EnumValues")).read_value()
            return {int(each.Value): str(each.DisplayName.Text) for each in labels}
        with contextlib.suppress(missing):
            labels = await (await node.get_child("0:EnumStrings")).read_value()
            return {number: str(text.Text) for number, text in enumerate(labels)}
        with contextlib.suppress(missing):
            definition = await node.read_data_type_definition()
            return {int(field.Value): str(field.Name) for field in definition.Fields}
        return {}

    async def _read_structure(self, node: Any) -> OpcuaKind:
        if not self._loaded:
            await self._client.load_data_type_definitions(overwrite_existing=True)
            self._loaded = True
        definition = await node.read_data_type_definition()
        return OpcuaKind(
            node.nodeid,
            self._ua.VariantType.ExtensionObject,
            fields={field.Name: await self.kind(field.DataType) for field in definition.Fields},
            optional=frozenset(field.Name for field in definition.Fields if field.IsOptional),
        )

    # -- there -------------------------------------------------------------------------------

    def make_variant(self, kind: OpcuaKind, value: Any) -> Any:
        """A value in the form for sending. Raises ValueError, TypeError."""
        return self._ua.Variant(self._encode(kind, value), kind.variant)

    def _encode(self, kind: OpcuaKind, value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [self._encode(kind, each) for each in value]
        if kind.labels:
            return _find_number(kind.labels, value)
        if kind.fields:
            return self._fill(kind, value)
        name = kind.variant.name if kind.variant is not None else ""
        if name in INTEGERS and isinstance(value, float):
            if not value.is_integer():
                raise ValueError(f"{value} is not a whole number")
            return int(value)
        if name == "LocalizedText" and isinstance(value, str):
            return self._ua.LocalizedText(value)
        if name == "DateTime" and isinstance(value, str):
            return datetime.datetime.fromisoformat(value)
        return value

    def _fill(self, kind: OpcuaKind, value: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError(f"it is a structure and needs a table of {', '.join(kind.fields)}")
        unknown = [name for name in value if name not in kind.fields]
        lacking = [name for name in kind.fields if name not in value and name not in kind.optional]
        if unknown or lacking:
            wrong = [f"has no {name!r}" for name in unknown] + [f"needs {name!r}" for name in lacking]
            raise ValueError(f"the structure {', '.join(wrong)}")
        from asyncua.common.structures104 import clean_name

        made = self._ua.extension_objects_by_datatype[kind.data_type]()
        for name, each in value.items():
            part = kind.fields[name]
            encoded = self._encode(part, each)
            if choice := self._ua.enums_by_datatype.get(part.data_type):
                encoded = [choice(one) for one in encoded] if isinstance(encoded, list) else choice(encoded)
            setattr(made, clean_name(name), encoded)
        return made


def _find_number(labels: dict[int, str], value: Any) -> int:
    """An enumeration's number, from the number or its label. Raises ValueError."""
    for number, label in labels.items():
        if value == label or (not isinstance(value, bool) and value == number):
            return number
    has = ", ".join(f"{label} ({number})" for number, label in labels.items())
    raise ValueError(f"the enumeration has {has}")


def make_plain(value: Any) -> Any:
    """A value in a form for JSON: structures are tables, enumerations in them labels, dates ISO 8601."""
    if isinstance(value, list | tuple):
        return [make_plain(each) for each in value]
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, datetime.datetime):
        return value.isoformat()
    if hasattr(value, "Text") and hasattr(value, "Locale"):
        return value.Text or ""
    if dataclasses.is_dataclass(value) and hasattr(value, "data_type"):
        names = [field.name for field in dataclasses.fields(value) if field.name != "Encoding"]
        return {name: make_plain(getattr(value, name)) for name in names}
    return value if isinstance(value, str | int | float | bytes | None) else str(value)
