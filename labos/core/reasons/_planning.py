"""Reasons that concern other runs, which pass or go first."""

from __future__ import annotations

from typing import Any

from labos.core.ids import local, split_key
from labos.core.reasons._base import NeedsPerson, Reason, in_words


class Reserved(Reason, frozen=True):
    SENTENCE = "{what} is reserved for run {run}, whose step {step!r} has to start in time"
    WAKES = ("cell", "window", "module", "station", "zone")
    what: str
    run: str
    step: str


class NotInTime(Reason, frozen=True):
    SENTENCE = "{what} will not be free in time for {step!r}"
    WAKES = ("module", "station", "zone", "cell")
    what: str
    step: str


class WouldDelay(Reason, frozen=True):
    SENTENCE = "starting {step!r} now would make run {run} late for {late!r}"
    WAKES = ("cell", "window", "module")
    step: str
    run: str
    late: str


class FollowsLate(Reason, frozen=True):
    SENTENCE = "if {step!r} started now, {late!r} could not start in time"
    WAKES = ("cell", "window", "module")
    step: str
    run: str
    late: str


class AfterElder(Reason, frozen=True):
    SENTENCE = "run {run} has waited longer and goes first"
    WAKES = ("cell", "near")
    run: str


class WouldBlock(Reason, frozen=True):
    SENTENCE = (
        "its first step waits until {onward} is free (at about {free_at}), because the run would block "
        "{place} before that"
    )
    WAKES = ("cell",)
    place: str
    onward: str
    free_at: str


class HoldsUp(Reason, frozen=True):
    SENTENCE = "its first step waits, because run {run} would otherwise wait for {place} until about {until}"
    WAKES = ("cell", "near", "module")
    run: str
    place: str
    until: str


class SearchForOrder(Reason, frozen=True):
    SENTENCE = "its first step waits a moment: the lab searches for an order in which all work ends sooner"
    WAKES = ("cell", "near", "module")


class SoonerLater(Reason, frozen=True):
    SENTENCE = "its first step waits, because all work would end later if it started now"
    WAKES = ("cell", "near", "module")


class ForOthers(Reason, frozen=True):
    SENTENCE = (
        "it waits for labware of other runs, so that {action!r} is done together: {taken} of {places} places "
        "of {module} are taken; until {until} at the latest"
    )
    WAKES = ("near",)
    action: str
    module: str
    taken: str
    places: str
    until: str


class SoonerAfter(Reason, frozen=True):
    SENTENCE = "all work ends sooner if {run} goes first, at {place}"
    WAKES = ("cell",)
    run: str
    place: str


class LaterHere(Reason, frozen=True):
    SENTENCE = "all work ends sooner if {step!r} starts later (at about {at})"
    WAKES = ("cell",)
    step: str
    at: str


class AfterSuggested(Reason, frozen=True):
    SENTENCE = "the planner suggests that {run} goes first, at {place}"
    WAKES = ("cell",)
    run: str
    place: str


class ClockLater(Reason, frozen=True):
    SENTENCE = "the planner suggests that the clock of {step!r} starts later (at about {at})"
    WAKES = ("cell",)
    step: str
    at: str


class BetterHere(NeedsPerson, frozen=True):
    SENTENCE = "{first} is unavailable, and after {step!r} this run would block others"
    WAKES = ("cell", "near", "module")
    step: str
    dead: tuple[str, ...]

    def _in_words(self) -> dict[str, Any]:
        return {"step": in_words(self.step), "first": local(self.dead[0])}


class NoWayOut(Reason, frozen=True):
    SENTENCE = "after {step!r} the run could not reach its end at present"
    REMEDY = (
        "It starts when its path is free. If no run moves the labware that is in the way, submit one "
        "that does."
    )
    WAKES = ("cell",)
    step: str
    run: str


class Unsafe(Reason, frozen=True):
    SENTENCE = "starting {step!r} now would trap {who}"
    WAKES = ("cell",)
    step: str
    trapped: tuple[str, ...]

    def _in_words(self) -> dict[str, Any]:
        return {"step": in_words(self.step), "who": ", ".join(_describe_owner(name) for name in self.trapped)}


def _describe_owner(name: str) -> str:
    kind, which = split_key(name)
    return f"experiment {which}" if kind == "experiment" else f"run {which or name}"


PlanningReason = (
    Reserved
    | NotInTime
    | WouldDelay
    | FollowsLate
    | ForOthers
    | AfterElder
    | SoonerAfter
    | LaterHere
    | AfterSuggested
    | ClockLater
    | WouldBlock
    | HoldsUp
    | SearchForOrder
    | SoonerLater
    | BetterHere
    | NoWayOut
    | Unsafe
)
