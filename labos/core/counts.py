"""The amount that an action will use up. Its driver reads it from the file that the action runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec


class Count(msgspec.Struct, frozen=True):
    """An amount, in the resource's unit. ``doubt`` says why the amount may be larger (as half a sentence); it
    is empty if the amount is certain. ``remedy`` says how a person can state the number in that file."""

    amount: float
    doubt: str = ""
    remedy: str = ""


Counter = Callable[[str, bytes, Mapping[str, Any]], Count]
"""Counts from a file's name, its content, and the known arguments of the action. The kernel calls it when a
run is submitted. So it may only read, and must end soon for any content of the file."""
