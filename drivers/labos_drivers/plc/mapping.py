"""The mapping of a PLC: its points, and their meanings.

The keys are those of ``epics:`` and ``opcua:`` (``set``, ``start``, ``done``, ``failed``, ``result``,
``timeout``; ``state``, ``boot``, ``reset``, ``stop``, ``labware``, ``resources``), and those of ``about:``
(``stations``, ``args``, ``effects``, ``duration``). In place of a condition, the name of a point means that
this bit is set. In place of a write, it means to set this bit.
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
    """The name of the argument in ``{argument}``; empty for any other value."""
    found = _WHOLE.fullmatch(value) if isinstance(value, str) else None
    return found[1] if found else ""


def fill_argument(value: Any, args: Mapping[str, Any]) -> Any:
    """The value itself, or for ``{argument}`` the value of this argument."""
    name = find_argument(value)
    return args[name] if name else value


class Point(Part):
    """One value in the PLC: a ``coil``, a ``discrete`` input, an ``input`` or a ``holding`` register, by its
    address on the wire (from 0). The value is ``raw × scale + offset``, in ``unit``. ``bit`` selects one bit
    of a register (0: the lowest). ``word_order`` is the order of the registers of a longer value: ``big``
    has the high word first."""

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
        """The type; if the mapping does not set it, ``bool`` for a bit and ``uint16`` for a register."""
        bare: Type = "bool" if self.table in ("coil", "discrete") or self.bit is not None else "uint16"
        return self.type or bare

    @property
    def width(self) -> int:
        """The number of bits (coils, discrete inputs) or of registers."""
        return REGISTERS.get(self.kind, 1)

    @property
    def value_type(self) -> Literal["bool", "int", "float"]:
        """The type of the value after decoding."""
        if self.kind == "bool":
            return "bool"
        whole = "float" not in self.kind and self.scale.is_integer() and self.offset.is_integer()
        return "int" if whole else "float"


class Write(Part):
    """A value to write to a point; ``{argument}`` stands for an argument of the action."""

    point: str
    value: Value = True


class Condition(Part):
    """A condition on the value of a point: it ``is`` one of these values, is ``near`` a number (``within`` a
    tolerance), is not below ``minimum``, not above ``maximum``. Without these keys: the bit is set. With
    ``not``, only its values mean the opposite. Any other value is undecided: then the module counts as busy,
    and it is not reported whether a place is empty. ``why`` and ``remedy`` are shown to a person."""

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
    """An action. ``needs`` is checked before anything is written. ``set`` has writes that move nothing,
    ``start`` is the one write that starts the motion. The action has ended when all conditions of ``done``
    hold, and has failed when one of ``failed`` holds. ``sets`` has the values of the module's variables
    afterwards, ``effects`` the other changes of the bench."""

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
        """The points from which the result is read."""
        named = self.result.values() if isinstance(self.result, dict) else [self.result]
        return [name for name in named if name]


class Code(Part):
    """The meaning of one number that the point ``why`` can have, and the remedy."""

    why: str
    remedy: str = ""


class State(Part):
    """The conditions that show that the PLC is busy or in error; one is enough. ``why`` is a point with the
    number of the fault, ``codes`` has the meaning of each number."""

    busy: Conditions = []
    error: Conditions = []
    why: str = ""
    codes: dict[str, Code] = {}


class Handshake(Part):
    """The points with which the PLC's program identifies each attempt by a number. It starts the action when
    ``number`` changes. ``taken`` shows the number that it accepted last, ``done`` the number of the last
    attempt that ended successfully."""

    number: str
    taken: str
    done: str


class Variable(Part):
    """A variable of the module: the value of a ``point``, or the first of ``values`` whose conditions all
    hold (else ``otherwise``). ``start`` is its value before the first observation, ``rest`` the value at
    which other runs may use the module."""

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
    """The whole mapping of a PLC."""

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
