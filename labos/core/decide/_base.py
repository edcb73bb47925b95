"""What every decision is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import chain, islice
from typing import Any, TypeVar

import msgspec

from labos.core.ids import StationName, local
from labos.core.registry import Event, encode
from labos.core.state import LabState

UNFIT = "unfit"
"""The code of a rejection whose events could not be written."""


class Command(msgspec.Struct, frozen=True, tag=True):
    """Somebody asks for something. Ids and times come in with the command."""

    def list_parts(self) -> Sequence[Command]:
        """The parts of this command: the actor must be allowed each of them, and the texts
        of each must be fit to be recorded. All of them are carried out, or none."""
        return ()


class Report(Command, frozen=True):
    """A device, a node or a program says what has happened. It is not refused for its words: long texts are
    cut."""


class Rejection(msgspec.Struct, frozen=True):
    """Why not, and what to do about it. ``code`` is for programs."""

    code: str
    message: str
    remedy: str = ""


Decision = Iterable[Event] | Rejection
"""A list of events is decided as a whole. What is worked out one by one (by a generator) finds each event
in the state when it works out the next; its first event does not depend on that."""

Decider = Callable[[LabState, Any], Decision]
D = TypeVar("D", bound=Decider)

DECIDERS: dict[type[Command], Decider] = {}


def check_recordable(events: Iterable[Event]) -> Decision:
    """The events, unless one of them cannot be written: then what somebody handed in is too large
    or no JSON. Of events that are worked out one by one the first is looked at."""
    later = None if isinstance(events, list) else iter(events)
    known = [*(events if later is None else islice(later, 1))]
    for event in known:
        try:
            encode(event)
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            return Rejection(
                UNFIT,
                f"This cannot be recorded: {str(error).rstrip('.')}.",
                "Hand large data in as a file.",
            )
    return known if later is None else chain(known, later)


def refuse_hotel(state: LabState, station: StationName) -> Rejection | None:
    """Why a station cannot be meant as one place: it is a hotel, and each of its shelves is a place."""
    shelves = state.bench.shelves.get(station)
    if not shelves:
        return None
    known = f"{len(shelves)} shelves: {local(shelves[0])} to {local(shelves[-1])}"
    return Rejection("many_shelves", f"{local(station)} has {known}.", "Name the shelf.")


def decides(command: type[Command]) -> Callable[[D], D]:
    """Register the function that decides a command."""

    def register(decider: D) -> D:
        DECIDERS[command] = decider
        return decider

    return register
