"""Reasons why a step does not start: a type for each, with its fields, its sentence and its remedy.

``WAKES`` are the kinds of keys whose change may end the wait (``labos.core.waits``). A reason's ``code`` is
its name in tables, metrics and answers.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import msgspec

from labos.core.ids import local, split_key
from labos.core.texts import make_code

Key = Literal["run", "module", "station", "zone", "access", "quota", "cell", "near", "window", "booking"]
"""The kinds of keys whose change may end a wait."""


class Reason(msgspec.Struct, frozen=True, tag_field="code", tag=make_code):
    """Why a step does not start. ``SENTENCE`` and ``REMEDY`` contain names of fields. ``PASSES``: the wait
    ends by itself."""

    SENTENCE: ClassVar[str]
    REMEDY: ClassVar[str] = ""
    WAKES: ClassVar[tuple[Key, ...]] = ()
    PASSES: ClassVar[bool] = True

    @property
    def code(self) -> str:
        return str(self.__struct_config__.tag)

    @property
    def names(self) -> tuple[str, ...]:
        """The names in its fields, in order."""
        found: list[str] = []
        for value in msgspec.structs.astuple(self):
            found += value if isinstance(value, tuple) else [value]
        return tuple(found)

    @property
    def sentence(self) -> str:
        """The sentence about what the step waits for, for scientists."""
        return self.SENTENCE.format(**self._in_words()).replace(" ()", "")

    @property
    def remedy(self) -> str:
        """The remedy for a person; empty if nobody can do anything but wait."""
        return self.REMEDY.format(**self._in_words())

    def _in_words(self) -> dict[str, Any]:
        values = msgspec.structs.asdict(self)
        return {name: in_words(v) if isinstance(v, str) else v for name, v in values.items()}


class NeedsPerson(Reason, frozen=True):
    """A reason that ends only when a person acts, or a device comes back."""

    PASSES = False


def in_words(name: str) -> str:
    """A module, station or labware without its workcell; an owner as text."""
    kind, which = split_key(name)
    return f"{kind} {which}" if which and kind in ("run", "experiment", "user") else local(name)
