"""The types that all decisions use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import chain, islice
from typing import Any, TypeVar

import msgspec

from labos.core.ids import StationName, local
from labos.core.registry import Event, encode
from labos.core.state import LabState

UNFIT = "unfit"
"""The code of a rejection of a command: its events cannot be written."""


class Command(msgspec.Struct, frozen=True, tag=True):
    """A request to the lab. Ids and times come in with the command."""

    def list_parts(self) -> Sequence[Command]:
        """The parts of this command. The actor must be allowed each of them, and the texts of each must be
        fit to be recorded. All of them are carried out, or none."""
        return ()


class InnerCommand(Command, frozen=True):
    """A command that LabOS itself sends. No user may."""


class Report(InnerCommand, frozen=True):
    """A device, a node or a program reports something that has happened. A report is not refused because of
    its texts: long texts are cut."""


class Rejection(msgspec.Struct, frozen=True):
    """Why a command cannot be carried out, and the remedy. ``code`` is for programs."""

    code: str
    message: str
    remedy: str = ""


Decision = Iterable[Event] | Rejection
"""A list of events is decided as a whole. A generator yields the events one by one: when it computes an
event, the state already has the ones before. Its first event does not depend on that."""

Decider = Callable[[LabState, Any], Decision]
D = TypeVar("D", bound=Decider)

DECIDERS: dict[type[Command], Decider] = {}


def check_recordable(events: Decision) -> Decision:
    """The decision, or a rejection if one of its events cannot be written because the input is too large or
    is not JSON. If the events are generated one by one, only the first is checked."""
    if isinstance(events, Rejection):
        return events
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


def list_possible(decision: Decision) -> Iterable[Event]:
    """The events of a decision; none if the command was rejected."""
    return () if isinstance(decision, Rejection) else decision


def refuse_hotel(state: LabState, station: StationName) -> Rejection | None:
    """Why a station cannot be used as one place: it is a hotel, and each of its shelves is a place."""
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
