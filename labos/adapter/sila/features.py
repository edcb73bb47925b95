"""The features of a SiLA 2 server, read from its feature definitions (SiLA 2 Part A, the FDL schema 1.1)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import msgspec

from labos.errors import DeviceError


class Limits(msgspec.Struct, frozen=True, omit_defaults=True):
    """The constraints of a value that an argument of LabOS can express; the server checks all constraints.
    Bounds are inclusive, in ``unit``."""

    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()


class Basic(msgspec.Struct, frozen=True):
    """String, Integer, Real, Boolean, Binary, Date, Time, Timestamp or Any."""

    name: str


class Named(msgspec.Struct, frozen=True):
    """A type that the feature defines, by its identifier."""

    name: str


class ListOf(msgspec.Struct, frozen=True):
    """Any number of values."""

    of: DataType


class Structure(msgspec.Struct, frozen=True):
    """Values by name."""

    elements: tuple[Element, ...]


class Constrained(msgspec.Struct, frozen=True):
    """A type whose values are limited."""

    of: DataType
    limits: Limits


DataType = Basic | Named | ListOf | Structure | Constrained


class Element(msgspec.Struct, frozen=True):
    """A parameter, a response, or an element of a structure."""

    name: str
    type: DataType
    description: str = ""


class SilaCommand(msgspec.Struct, frozen=True):
    """A command of a feature, which is in ``package``. The answer to an observable command comes at once,
    with the UUID of its execution."""

    package: str
    feature: str
    name: str
    observable: bool = False
    description: str = ""
    parameters: tuple[Element, ...] = ()
    responses: tuple[Element, ...] = ()
    intermediate: tuple[Element, ...] = ()
    errors: tuple[str, ...] = ()

    @property
    def full_name(self) -> str:
        return f"{self.feature}.{self.name}"


class Property(msgspec.Struct, frozen=True):
    """A value that can be read; an observable property is read by subscription."""

    package: str
    feature: str
    name: str
    type: DataType
    observable: bool = False

    @property
    def method(self) -> str:
        """The name of the remote call."""
        return f"{'Subscribe' if self.observable else 'Get'}_{self.name}"


class Feature(msgspec.Struct, frozen=True):
    """One feature of a server."""

    name: str
    originator: str
    category: str
    version: int
    commands: tuple[SilaCommand, ...] = ()
    properties: tuple[Property, ...] = ()
    types: tuple[Element, ...] = ()

    @property
    def package(self) -> str:
        """The package of its messages and calls."""
        return package_of(self.originator, self.category, self.name, self.version)

    @property
    def identifier(self) -> str:
        """Its full name in SiLA."""
        return f"{self.originator}/{self.category}/{self.name}/v{self.version}"

    @property
    def is_standard(self) -> bool:
        """Whether SiLA defines it for all servers, so that it is not a function of the device."""
        return self.originator == "org.silastandard" and self.category.partition(".")[0] == "core"


def package_of(originator: str, category: str, name: str, version: int) -> str:
    """The package of a feature in the names of protobuf (SiLA 2 Part B), by its major version."""
    return f"sila2.{originator}.{category}.{name.lower()}.v{version}"


def read_feature(text: str) -> Feature:
    """A feature from its definition in XML. Raises DeviceError (``none``)."""
    try:
        root = ET.fromstring(text)
        name = _text(root, "Identifier")
        originator, category = root.attrib["Originator"], root.attrib.get("Category", "none")
        version = int(root.attrib["FeatureVersion"].partition(".")[0])
        package = package_of(originator, category, name, version)
        return Feature(
            name=name,
            originator=originator,
            category=category,
            version=version,
            commands=tuple(_command(package, name, found) for found in _find_all(root, "Command")),
            properties=tuple(
                Property(package, name, _text(found, "Identifier"), _read_type(found), _is_observable(found))
                for found in _find_all(root, "Property")
            ),
            types=_elements(root, "DataTypeDefinition"),
        )
    except RecursionError:
        raise DeviceError(
            "A feature definition of the server is nested too deeply.", effects="none"
        ) from None
    except (ET.ParseError, KeyError, ValueError, StopIteration, RuntimeError) as error:
        # A data type that is missing ends an iteration: within a generator that is a RuntimeError.
        raise DeviceError(
            f"A feature definition of the server cannot be read ({error}).", effects="none"
        ) from error


def _command(package: str, feature: str, found: ET.Element) -> SilaCommand:
    errors = _find_all(found, "DefinedExecutionErrors")
    return SilaCommand(
        package=package,
        feature=feature,
        name=_text(found, "Identifier"),
        observable=_is_observable(found),
        description=_text(found, "Description"),
        parameters=_elements(found, "Parameter"),
        responses=_elements(found, "Response"),
        intermediate=_elements(found, "IntermediateResponse"),
        errors=tuple(_read_words(name) for each in errors for name in _find_all(each, "Identifier")),
    )


def _elements(parent: ET.Element, tag: str) -> tuple[Element, ...]:
    return tuple(
        Element(_text(found, "Identifier"), _read_type(found), _text(found, "Description"))
        for found in _find_all(parent, tag)
    )


def _read_type(parent: ET.Element) -> DataType:
    """The data type below an element. Raises ValueError."""
    element = next(iter(_find_one(parent, "DataType")))
    match _strip_namespace(element):
        case "Basic":
            return Basic(_read_words(element))
        case "DataTypeIdentifier":
            return Named(_read_words(element))
        case "List":
            return ListOf(_read_type(element))
        case "Structure":
            return Structure(_elements(element, "Element"))
        case "Constrained":
            inner = _read_type(element)
            return Constrained(inner, _read_limits(_find_one(element, "Constraints"), inner))
    raise ValueError(f"there is no data type {_strip_namespace(element)!r}")


def _read_limits(constraints: ET.Element, of: DataType) -> Limits:
    """The narrower of the bounds. Excluded bounds are expressed only for whole numbers; for other numbers,
    the server refuses the bound itself."""
    step = 1.0 if of == Basic("Integer") else 0.0
    low, high = [], []
    unit: str = ""
    choices: tuple[str, ...] = ()
    for found in constraints:
        match _strip_namespace(found):
            case "MinimalInclusive":
                low.append(float(_read_words(found)))
            case "MinimalExclusive":
                low.append(float(_read_words(found)) + step)
            case "MaximalInclusive":
                high.append(float(_read_words(found)))
            case "MaximalExclusive":
                high.append(float(_read_words(found)) - step)
            case "Unit":
                unit = _text(found, "Label")
            case "Set":
                choices = tuple((value.text or "").strip() for value in _find_all(found, "Value"))
    if of not in (Basic("Integer"), Basic("Real")):
        low, high = [], []  # of dates and times
    return Limits(unit, max(low, default=None), min(high, default=None), choices)


# -- XML without its name space, which changed between versions of SiLA ----------------------


def _strip_namespace(found: ET.Element) -> str:
    return found.tag.rpartition("}")[2]


def _find_all(parent: ET.Element, tag: str) -> list[ET.Element]:
    return [child for child in parent if _strip_namespace(child) == tag]


def _find_one(parent: ET.Element, tag: str) -> ET.Element:
    found = _find_all(parent, tag)
    if len(found) != 1:
        raise ValueError(f"{_strip_namespace(parent)} has {len(found)} {tag}")
    return found[0]


def _read_words(found: ET.Element) -> str:
    return " ".join((found.text or "").split())


def _text(parent: ET.Element, tag: str) -> str:
    return _read_words(_find_one(parent, tag))


def _is_observable(found: ET.Element) -> bool:
    return _text(found, "Observable") == "Yes"


def unwrap(data_type: DataType, types: dict[str, DataType]) -> Iterator[Any]:
    """A type and its underlying types, as long as each is a constrained or named form of the next; ends at a
    repeated name."""
    named: set[str] = set()
    while True:
        yield data_type
        match data_type:
            case Constrained():
                data_type = data_type.of
            case Named() if data_type.name in types and data_type.name not in named:
                named.add(data_type.name)
                data_type = types[data_type.name]
            case _:
                return
