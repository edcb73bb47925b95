"""What is written of a PLC: its points, and which of them mean what.

The words are those of ``epics:`` and ``opcua:`` (``set``, ``start``, ``done``, ``failed``, ``result``,
``timeout``; ``state``, ``boot``, ``reset``, ``stop``, ``labware``, ``resources``), and those of ``about:``
(``stations``, ``args``, ``effects``, ``duration``). A name where a condition or a write may stand is a bit
that is set.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from labos.node.mapping import ArgAbout, Name, Part, Seconds, StationAbout

Where = Literal["coil", "discrete", "input", "holding"]
TABLES: tuple[Where, ...] = ("coil", "discrete", "input", "holding")
Type = Literal["bool", "int16", "uint16", "int32", "uint32", "float32", "int64", "uint64", "float64"]
REGISTERS: dict[str, int] = {
    **dict.fromkeys(("int16", "uint16"), 1),
    **dict.fromkeys(("int32", "uint32", "float32"), 2),
    **dict.fromkeys(("int64", "uint64", "float64"), 4),
}
"""How many registers a value of a type takes."""

Address = Annotated[int, Field(ge=0, le=65535)]
Value = bool | int | float | str


_WHOLE = re.compile(r"\{(\w+)\}")


def find_argument(value: Any) -> str:
    """The argument that a written value names; empty if it is a value."""
    found = _WHOLE.fullmatch(value) if isinstance(value, str) else None
    return found[1] if found else ""


def fill_argument(value: Any, args: Mapping[str, Any]) -> Any:
    """The value, with the argument in place of ``{argument}``."""
    name = find_argument(value)
    return args[name] if name else value


class Point(Part):
    """One value in the PLC: a ``coil``, a ``discrete`` input, an ``input`` or a ``holding`` register, by its
    address on the wire (from 0). What is told is ``raw × scale + offset``, in ``unit``. ``bit`` is one of a
    register (0: the lowest). Of a value in several registers, ``word_order`` says which word comes first."""

    coil: Address | None = None
    discrete: Address | None = None
    input: Address | None = None
    holding: Address | None = None
    type: Type | None = None
    bit: int | None = Field(default=None, ge=0, le=15)
    word_order: Literal["big", "little"] = "big"
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None

    @model_validator(mode="after")
    def _check_address(self) -> Point:
        places = [table for table in TABLES if getattr(self, table) is not None]
        if len(places) != 1:
            raise ValueError(f"a point is in one of {', '.join(TABLES)}")
        if places[0] in ("coil", "discrete"):
            if self.type not in (None, "bool") or self.bit is not None:
                raise ValueError(f"a {places[0]} is a bit and cannot have another type")
        elif self.type == "bool" and self.bit is None:
            raise ValueError("a bit of a register needs `bit`")
        elif self.type not in (None, "bool") and self.bit is not None:
            raise ValueError("a bit cannot have another type")
        if self.scale == 0:
            raise ValueError("a scale cannot be 0")
        if self.address + self.width > 65536:
            raise ValueError("the last register is 65535")
        return self

    @property
    def table(self) -> Where:
        return next(table for table in TABLES if getattr(self, table) is not None)

    @property
    def address(self) -> int:
        return int(getattr(self, self.table))

    @property
    def kind(self) -> Type:
        """The type, also where the table does not say it."""
        bare: Type = "bool" if self.table in ("coil", "discrete") or self.bit is not None else "uint16"
        return self.type or bare

    @property
    def width(self) -> int:
        """Bits or registers."""
        return REGISTERS.get(self.kind, 1)

    @property
    def value_type(self) -> Literal["bool", "int", "float"]:
        """What a value is, once it is read."""
        if self.kind == "bool":
            return "bool"
        whole = "float" not in self.kind and self.scale.is_integer() and self.offset.is_integer()
        return "int" if whole else "float"


class Write(Part):
    """A value for a point; ``{argument}`` is that of the action."""

    point: str
    value: Value = True


class Condition(Part):
    """What a point tells: ``is`` one of these values, ``near`` a number ``within`` a tolerance, not below
    ``minimum``, not above ``maximum``; nothing of it: a bit that is set. With ``not``, only its values say
    the opposite: any other says nothing, so that the module is not idle and a place not empty by it. ``why``
    and ``remedy`` are what a person is told by it."""

    point: str
    is_: Value | list[Value] | None = Field(default=None, alias="is")
    not_: Value | list[Value] | None = Field(default=None, alias="not")
    near: float | int | str | None = None
    within: float = Field(default=0.0, ge=0)
    minimum: float | None = None
    maximum: float | None = None
    why: str = ""
    remedy: str = ""

    @property
    def has_no_comparison(self) -> bool:
        return self.is_ is None and self.near is None and self.minimum is None and self.maximum is None


def _parse_point(written: Any) -> Any:
    return {"point": written} if isinstance(written, str) else written


def _parse_list(written: Any) -> Any:
    if isinstance(written, str | dict):
        return [_parse_point(written)]
    return [_parse_point(each) for each in written] if isinstance(written, list) else written


OneWrite = Annotated[Write, BeforeValidator(_parse_point)]
Writes = Annotated[list[Write], BeforeValidator(_parse_list)]
Conditions = Annotated[list[Condition], BeforeValidator(_parse_list)]


class MappedAction(Part):
    """An action. ``needs`` is looked at before anything is written; ``set`` is what moves nothing, ``start``
    the one write that moves; it is ``done`` when all of these hold, and has ``failed`` when one of those
    does. ``sets`` are the module's variables afterwards, ``effects`` what else it does to the bench."""

    description: str
    needs: Conditions = []
    set: Writes = []
    start: OneWrite | None = None
    done: Conditions = []
    failed: Conditions = []
    result: str | dict[str, str] = ""
    timeout: Seconds | None = Field(default=None, gt=0)
    sets: dict[str, Any] = {}
    args: dict[Name, ArgAbout] = {}
    effects: list[dict[str, dict[str, Any] | None]] = []
    duration: Annotated[Seconds, Field(gt=0)] = 1.0
    safe_to_repeat: bool = False
    aliases: list[str] = []

    @property
    def only_reads(self) -> bool:
        return bool(self.result) and self.start is None and not self.set and not self.done

    @property
    def result_points(self) -> list[str]:
        """The points that the result is read from."""
        named = self.result.values() if isinstance(self.result, dict) else [self.result]
        return [name for name in named if name]


class Code(Part):
    """The meaning of a number of ``why``, and the remedy."""

    why: str
    remedy: str = ""


class State(Part):
    """How the PLC says that it is busy or in error. ``why`` is a point with the number of the fault."""

    busy: Conditions = []
    error: Conditions = []
    why: str = ""
    codes: dict[str, Code] = {}


class Handshake(Part):
    """The PLC's program knows each attempt by a number. It begins when ``number`` changes, shows in
    ``taken`` the number that it began last, in ``done`` the one that it ended last, and well."""

    number: str
    taken: str
    done: str


class Variable(Part):
    """A variable of the module: what a ``point`` tells, or the first of ``values`` whose conditions all
    hold (else ``otherwise``). ``start`` is its value before anybody has looked, ``rest`` the one that lets
    others use the module."""

    start: Value
    point: str = ""
    values: dict[str, Conditions] = {}
    otherwise: Value = "between"
    rest: Value | None = None

    @model_validator(mode="after")
    def _check_source(self) -> Variable:
        if bool(self.point) == bool(self.values):
            raise ValueError("a variable needs either `point` or `values`")
        return self


class PlcMapping(Part):
    """The whole table."""

    description: str
    points: dict[Name, Point]
    actions: dict[Name, MappedAction]
    stations: dict[Name, StationAbout] = {}
    variables: dict[Name, Variable] = {}
    labware: dict[str, Conditions] = {}
    resources: dict[str, str] = {}
    levels: dict[str, float] = {}
    units: dict[str, str] = {}
    state: State = State()
    handshake: Handshake | None = None
    boot: str = ""
    reset: Writes = []
    stop: Writes = []
