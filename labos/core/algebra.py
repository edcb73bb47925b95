"""Why an effect may not happen, and what it does: once for each kind of effect, for everybody who asks.

What a kind of effect needs stands with the effect itself (``effects``). Here it is asked of a *store*: a
bench as somebody knows it. The rules ask the state (``binding``), safety its floor (``planning.moves``), a
rehearsal its scene (``planning.scene``), a dry run its paper (``spec.dryrun``); obstacles in words and those
who have to move first are found by the same questions. So what is asked, and of which stations, is the same
for all of them; what a store answers is its own: a wait, yes or no, who is in the way, a sentence.

A new need of effects is a new question here. Until every store answers it, the type check fails.

What an action leaves its module set to (``compute_settings_after``), and when a door or lid keeps others out
(``away_from_rest``), is said here too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol, TypeVar

import msgspec

from labos.core.effects import Carrying, Claims, Consumes, Effect, Lid, Needs, Releases, Requires, Sets
from labos.core.ids import StationName


class NeedsRoom(Protocol):
    """An effect, or a motion that stands for some."""

    @property
    def room(self) -> tuple[StationName, ...]: ...


class Carried(NeedsRoom, Protocol):
    """What is known of something that is carried: an effect, or a motion that stands for one."""

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
"""What a store can be asked about: effects, or motions that stand for them."""

Why = TypeVar("Why", covariant=True)
"""How a store says that something is in the way."""


class RoomLookup(Protocol[Asked, Why]):
    """What of a bench is asked of effects that carry nothing."""

    def check_room(self, what: Asked, place: StationName) -> Why | None: ...


class BenchLookup(Protocol[Asked, Why]):
    """Where things stand. Each question is answered with what is in the way; None if nothing is."""

    def stock(self, what: Asked, stack: StationName) -> Why | None:
        """Whether a nameless item lies on top of a stack."""

    def check_stands(self, what: Asked, place: StationName) -> Why | None:
        """Whether labware stands at a place that may be used; on a stack, as the topmost."""

    def check_hand(self, what: Asked) -> Why | None:
        """Whether the hand that carries is empty, or holds what it is to put down."""

    def check_entry(self, what: Asked, place: StationName) -> Why | None:
        """Whether a hand may reach into a place: its module lets it in, and nobody else keeps it."""

    def check_room(self, what: Asked, place: StationName) -> Why | None:
        """Whether there is room for one piece more."""


class Store(BenchLookup[Carrying, Why], Protocol[Why]):
    """A bench that can be asked about every kind of effect, and that knows what labware is like."""

    def check_fits(self, what: Carrying) -> Why | None:
        """Whether what is carried is as it has to be: of a type that its target takes, with a grip by which
        it can be held, the right way round, with a lid or without one. Asked once it is known to be there."""

    def check_room(self, what: Effect, place: StationName) -> Why | None:
        """Whether there is room for one piece more. It is asked of every kind of effect."""

    def check_labware(self, needs: Needs) -> Why | None:
        """Whether labware stands where it is worked on."""

    def check_value(self, requires: Requires) -> Why | None:
        """Whether a variable has the value that it must have."""

    def check_setpoint(self, claims: Claims) -> Why | None:
        """Whether nobody else needs another value."""

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
        why = bench.check_stands(what, place)
        if why is not None:
            return why
    return None


def check_reaching(bench: BenchLookup[Thing, Reason], what: Thing) -> Reason | None:
    """Why something that is there cannot be carried to where it goes; None if it can."""
    why = bench.check_hand(what)
    if why is not None:
        return why
    for place in what.entered:
        why = bench.check_entry(what, place)
        if why is not None:
            return why
    return check_rooms(bench, what)


def check_carrying(bench: BenchLookup[Thing, Reason], what: Thing) -> Reason | None:
    """Why something cannot be carried, whatever it is like; None if it can."""
    why = check_standing(bench, what)
    return check_reaching(bench, what) if why is None else why


def check_effect(store: Store[Reason], effect: Effect) -> Reason | None:
    """Why an effect may not happen; None if it may. Those of the other kinds need room at most."""
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
    return check_rooms(store, effect) if why is None else why


class PieceCount(Protocol):
    """Who keeps count of labware with a name by its places."""

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
    """What an action leaves its module set to: its variables, the setpoints that its run needs to stay, and
    those that it does not need any more."""

    variables: dict[str, Any] = {}
    claims: dict[str, Any] = {}
    releases: tuple[str, ...] = ()


NOTHING_SET = ModuleSettings()


def compute_settings_after(effects: Iterable[object]) -> ModuleSettings:
    """What some effects set of their module."""
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
    return (
        ModuleSettings(variables, claims, tuple(releases)) if variables or claims or releases else NOTHING_SET
    )


def find_requirements(effects: Iterable[object]) -> dict[str, Any]:
    """The variables of their module that some effects need, and the values that they must have."""
    return {e.variable: e.value for e in effects if isinstance(e, Requires) and e.of == "module"}


def list_away_from_rest(values: Mapping[str, Any], rest: Mapping[str, Any]) -> list[str]:
    """The doors and lids that do not stand as they rest; the run that left them so keeps the module."""
    return [name for name, value in rest.items() if values.get(name, value) != value]
