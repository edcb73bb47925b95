"""Why an effect may not happen, and its results: defined once for each kind of effect, for all callers.

The requirements of a kind of effect are declared with the effect itself (``effects``). Here they are checked
against a *store*: one view of the bench. The rules use the state as store (``binding``), and the safety check
uses its floor (``planning.moves``). A rehearsal uses its scene (``planning.scene``), and a dry run its paper
(``spec.dryrun``). The explanation of obstacles and the search for runs that have to move first use the same
checks. So all of them check the same conditions at the same stations. Only the answers differ: a wait, yes or
no, the runs in the way, or a sentence.

A new requirement of effects is a new method of ``Store``. Until every store has it, the type check fails.

This module also computes the settings of a module after an action (``compute_settings_after``), and lists the
doors and lids that are not in their rest positions (``list_away_from_rest``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol, TypeVar

import msgspec

from labos.core.effects import (
    AnyEffect,
    Carrying,
    Claims,
    Consumes,
    Draws,
    Effect,
    Lid,
    Needs,
    Reads,
    Releases,
    Replaces,
    Requires,
    Sets,
    Transfers,
)
from labos.core.ids import StationName


class NeedsRoom(Protocol):
    """An effect, or a motion that stands for some."""

    @property
    def room(self) -> tuple[StationName, ...]: ...


class Carried(NeedsRoom, Protocol):
    """Data of something that is carried: an effect, or a motion that stands for one."""

    @property
    def source(self) -> StationName: ...
    @property
    def target(self) -> StationName: ...
    @property
    def via(self) -> StationName: ...
    @property
    def lid(self) -> Lid: ...
    @property
    def stock(self) -> StationName: ...
    @property
    def stands(self) -> tuple[StationName, ...]: ...
    @property
    def entered(self) -> tuple[StationName, ...]: ...
    @property
    def emptied(self) -> StationName: ...
    @property
    def filled(self) -> StationName: ...


Asked = TypeVar("Asked", contravariant=True)
"""The things that can be checked against a store: effects, or motions that stand for them."""

Why = TypeVar("Why", covariant=True)
"""How a store says that something is in the way."""


class RoomLookup(Protocol[Asked, Why]):
    """What of a bench is asked of effects that carry nothing."""

    def check_room(self, what: Asked, place: StationName) -> Why | None: ...


class BenchLookup(Protocol[Asked, Why]):
    """Where labware stands. Each method returns the obstacle, or None if there is none."""

    def stock(self, what: Asked, stack: StationName) -> Why | None:
        """Whether a nameless item lies on top of a stack."""

    def check_presence(self, what: Asked, place: StationName) -> Why | None:
        """Whether labware stands at a place that may be used; on a stack, as the topmost."""

    def check_hand(self, what: Asked) -> Why | None:
        """Whether the hand that carries is empty, or holds the labware that it has to put down."""

    def check_entry(self, what: Asked, place: StationName) -> Why | None:
        """Whether a hand may reach into a place: its module is open for hands, and no other run keeps it."""

    def check_room(self, what: Asked, place: StationName) -> Why | None:
        """Whether there is room for one piece more."""


class Store(BenchLookup[Carrying, Why], Protocol[Why]):
    """A bench on which every kind of effect can be checked, with the properties of labware."""

    def check_fits(self, what: Carrying) -> Why | None:
        """Whether the carried labware meets the requirements: a type that the target accepts, a grip by which
        the arm can hold it, the right orientation, with or without a lid. The caller has checked before that
        the labware is there."""

    def check_room(self, what: Effect, place: StationName) -> Why | None:
        """Whether there is room for one piece more. It is asked of every kind of effect."""

    def check_labware(self, needs: Needs) -> Why | None:
        """Whether labware stands where it is worked on."""

    def check_value(self, requires: Requires) -> Why | None:
        """Whether a variable has the value that it must have."""

    def check_setpoint(self, claims: Claims) -> Why | None:
        """Whether no other run needs a different value."""

    def check_amount(self, consumes: Consumes) -> Why | None:
        """Whether enough is left."""


Thing = TypeVar("Thing", bound=Carried)
Put = TypeVar("Put", bound=NeedsRoom)
Reason = TypeVar("Reason")


def check_rooms(bench: RoomLookup[Put, Reason], what: Put) -> Reason | None:
    """Why there is no room where some is needed; None if there is."""
    for place in what.room:
        why = bench.check_room(what, place)
        if why is not None:
            return why
    return None


def check_standing(bench: BenchLookup[Thing, Reason], what: Thing) -> Reason | None:
    """Why there is nothing to carry; None if there is."""
    if what.stock:
        why = bench.stock(what, what.stock)
        if why is not None:
            return why
    for place in what.stands:
        why = bench.check_presence(what, place)
        if why is not None:
            return why
    return None


def check_reaching(bench: BenchLookup[Thing, Reason], what: Thing) -> Reason | None:
    """Why labware that is there cannot be carried to its target; None if it can."""
    why = bench.check_hand(what)
    if why is not None:
        return why
    for place in what.entered:
        why = bench.check_entry(what, place)
        if why is not None:
            return why
    return check_rooms(bench, what)


def check_carrying(bench: BenchLookup[Thing, Reason], what: Thing) -> Reason | None:
    """Why something cannot be carried, without a check of the labware's properties; None if it can."""
    why = check_standing(bench, what)
    return check_reaching(bench, what) if why is None else why


def check_effect(store: Store[Reason], effect: AnyEffect) -> Reason | None:
    """Why an effect may not happen; None if it may."""
    why: Reason | None = None
    match effect:
        case Carrying():
            why = check_standing(store, effect)
            why = store.check_fits(effect) if why is None else why
            return check_reaching(store, effect) if why is None else why
        case Needs():
            why = store.check_labware(effect)
        case Requires():
            why = store.check_value(effect)
        case Claims():
            why = store.check_setpoint(effect)
        case Consumes():
            why = store.check_amount(effect)
        case Sets() | Replaces() | Releases() | Reads() | Transfers() | Draws():
            pass  # they need room at most
    return check_rooms(store, effect) if why is None else why


class PieceCount(Protocol):
    """A store that counts the pieces of labware at each place."""

    def lift(self, place: StationName) -> None:
        """One piece of labware leaves a place."""

    def put(self, place: StationName) -> None:
        """One piece of labware comes to a place."""


def carry(count: PieceCount, what: Carried) -> None:
    """Note where labware stands once something has been carried."""
    if what.emptied and not what.stock:
        count.lift(what.emptied)
    if what.filled:
        count.put(what.filled)


class ModuleSettings(msgspec.Struct, frozen=True):
    """The settings of a module after an action: its variables, the setpoints that its run still needs, and
    the setpoints that it no longer needs."""

    variables: dict[str, Any] = {}
    claims: dict[str, Any] = {}
    releases: tuple[str, ...] = ()


NOTHING_SET = ModuleSettings()


def compute_settings_after(effects: Iterable[object]) -> ModuleSettings:
    """The settings of a module after these effects."""
    variables: dict[str, Any] = {}
    claims: dict[str, Any] = {}
    releases: list[str] = []
    for effect in effects:
        match effect:
            case Sets(of="module"):
                variables[effect.variable] = effect.value
            case Claims():
                claims[effect.setpoint] = effect.value
            case Releases():
                releases.append(effect.setpoint)
            case _:
                pass
    return (
        ModuleSettings(variables, claims, tuple(releases)) if variables or claims or releases else NOTHING_SET
    )


def find_requirements(effects: Iterable[object]) -> dict[str, Any]:
    """The variables of their module that some effects need, and the values that they must have."""
    return {e.variable: e.value for e in effects if isinstance(e, Requires) and e.of == "module"}


def list_away_from_rest(values: Mapping[str, Any], rest: Mapping[str, Any]) -> list[str]:
    """The doors and lids that are not in their rest positions. The run that left them so keeps the module."""
    return [name for name, value in rest.items() if values.get(name, value) != value]
