"""Suggested orders: the order in which a planner would start the next steps of a workcell.

A suggestion changes only the order among steps that may start anyway.
"""

from __future__ import annotations

import msgspec

from labos.core.ids import RunId
from labos.core.registry import Event, event

MOST_STEPS = 600
"""The most steps of a suggestion."""


class Suggested(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False, omit_defaults=True):
    """A step of a run should start at ``start`` (UTC ns). ``outside``: the run waits outside until then."""

    run: RunId
    step: int
    start: int
    outside: bool = False


@event("order.suggested")
class OrderSuggested(Event, frozen=True):
    """A planner suggests an order for starting ``steps`` of a workcell, the earliest first. It replaces the
    previous suggestion and is valid until ``until`` (UTC ns). ``line``: in place of steps, an order of runs
    with which the lab's own search for an order begins, if the runs have windows."""

    workcell: str
    by: str
    until: int
    steps: tuple[Suggested, ...]
    line: tuple[RunId, ...] = ()

    def stream(self) -> str:
        return f"order:{self.workcell}"


class Suggestions(msgspec.Struct):
    """The last suggestion for each workcell."""

    orders: dict[str, OrderSuggested] = {}

    def find(self, cell: str, now: int) -> OrderSuggested | None:
        """The suggestion that is valid now (UTC ns); None if it was withdrawn or is over."""
        order = self.orders.get(cell)
        return order if order is not None and order.steps and order.until > now else None

    def find_line(self, cell: str, now: int) -> tuple[RunId, ...]:
        """The order of runs that is suggested for the lab's own search; empty if there is none now."""
        order = self.orders.get(cell)
        return order.line if order is not None and order.until > now else ()


def fold_suggested(suggestions: Suggestions, event: OrderSuggested, at: int) -> None:
    suggestions.orders[event.workcell] = event
