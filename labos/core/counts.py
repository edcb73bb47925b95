"""How much an action will use up, as its driver reads it from the file that the action runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec


class Count(msgspec.Struct, frozen=True):
    """An amount, in the resource's unit. ``doubt`` says why it may be more (as half a sentence), empty
    where it is certain; ``remedy`` how somebody can say the number in that file."""

    amount: float
    doubt: str = ""
    remedy: str = ""


Counter = Callable[[str, bytes, Mapping[str, Any]], Count]
"""Counts from a file's name, its content, and those arguments of the action that are known. It is asked
when a run is submitted, in the kernel: it only reads, and ends soon whatever the file holds."""
