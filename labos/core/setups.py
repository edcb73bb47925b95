"""Set-ups: the time to change a module from one value of an argument to another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec


class SetupChange(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A change with a set-up time of its own: ``takes_s`` lab seconds."""

    before: Any
    after: Any
    takes_s: float


class Setup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A module is set up for a value of an ``argument`` of its actions. An action with another value takes
    ``takes_s`` lab seconds longer, or the time in ``changes`` for that change. The same holds if it is
    unknown for which value the module is set up."""

    argument: str
    takes_s: float
    changes: tuple[SetupChange, ...] = ()

    def compute_cost_s(self, before: Any, args: Mapping[str, Any]) -> float:
        """The additional lab seconds of an action with these arguments on a module that is set up for
        ``before`` (None: unknown). It is 0 for an action without the argument."""
        if self.argument not in args or args[self.argument] == before:
            return 0.0
        after = args[self.argument]
        return next(
            (c.takes_s for c in self.changes if c.before == before and c.after == after), self.takes_s
        )
