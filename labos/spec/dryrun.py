"""Runs a plan's effects on paper: where its labware goes, and what cannot work.

The dry run knows nothing of other runs. What a step uses without the run having brought it
there must stand there when the run starts: these stations are the plan's inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from typing import Any

from labos.core.bench import parts
from labos.core.effects import (
    AnyEffect,
    Draws,
    Move,
    Needs,
    Relid,
    Requires,
    Sets,
    Take,
    Transfers,
    Unlid,
    turn,
)
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import Description, LabwareSpec, ModuleSpec, PlanStep, StationSpec
from labos.core.wells import add_doses, doses_of, draw_doses, misfit
from labos.spec.stations import Stations

Tell = Callable[[int, str, str], None]
"""Called with the index of a step, what is wrong with it, and a remedy."""

UNKNOWN: Any = object()


class Piece:
    """One piece of labware of the run. ``item`` is its type, and that of its lid if it has one."""

    def __init__(self, item: str, *, fresh: bool) -> None:
        self.kind, lid = parts(item)
        self.fresh = fresh
        """Whether it came from a stack; of other labware the variables are not known."""
        self.variables: dict[str, Any] = {}
        self.at_first: dict[str, Any] = {}
        """What its variables must have been when the run began."""
        self.lid = Piece(lid, fresh=fresh) if lid else None
        self.volumes_ul: dict[str, float] = {}
        self.parked: StationName | None = None
        """Where its lid was put."""

    def variable(self, name: str) -> Any:
        if name == "lidded" and (self.lid is not None or self.fresh):
            return self.lid is not None
        return self.variables.get(name, False if self.fresh else UNKNOWN)


class DryRun:
    """The bench as far as one run knows it."""

    def __init__(
        self,
        stations: Stations,
        modules: Mapping[ModuleName, ModuleSpec],
        descriptions: Mapping[ModuleName, Description],
        labware: Mapping[str, LabwareSpec],
        stock: Mapping[StationName, str],
        counts: dict[StationName, int] | None,
        error: Tell,
        warning: Tell,
    ) -> None:
        self.stations, self.modules, self.descriptions = stations, modules, descriptions
        self.labware = labware
        self.stock, self.counts, self.error, self.warning = stock, counts, error, warning
        self.at: dict[StationName, list[Piece]] = {}
        self.inputs: list[StationName] = []
        self.missing: list[StationName] = []
        self.taken: list[tuple[StationName, Piece]] = []
        """What must stand there at the start, or be in a module that has several stations."""
        self.left: set[StationName] = set()
        """Where labware of the run stood, and was taken away. Not kept where conditions decide about steps:
        of two that exclude each other both go through here."""
        self.variables = {name: dict(module.rest) for name, module in modules.items()}
        self.taught = {arm for station in stations.by_name.values() for arm in station.reach}

    def copy(self, error: Tell) -> DryRun:
        """The bench as it stands now, to try out something else on; faults go to ``error``."""
        counts = None if self.counts is None else dict(self.counts)
        known = (self.stations, self.modules, self.descriptions, self.labware)
        other = DryRun(*known, self.stock, counts, error, error)
        other.at, other.variables = deepcopy((self.at, self.variables), {id(UNKNOWN): UNKNOWN})
        other.inputs, other.left = list(self.inputs), set(self.left)
        return other

    def mark(self) -> object:
        """What tells one state of the bench from another."""
        here = [
            (
                place,
                piece.kind,
                piece.lid is not None,
                sorted((n, repr(v)) for n, v in piece.variables.items()),
            )
            for place, pieces in self.at.items()
            for piece in pieces
        ]
        return repr((sorted(here), sorted((name, sorted(v.items())) for name, v in self.variables.items())))

    def run(self, steps: Sequence[tuple[int, PlanStep]], after: Callable[[int], None] | None = None) -> None:
        """Go through the steps in the order given. ``after`` is called behind each of them."""
        is_conditional = any(step.when is not None for _, step in steps)
        for index, step in steps:
            if is_conditional:
                self.left.clear()
            works_on = self._works_on(step)
            for effect in step.effects:
                if isinstance(effect, Needs):
                    piece = self._needed(index, step, effect)
                    works_on = works_on or piece
            for effect in step.effects:
                if isinstance(effect, Requires):
                    self._require(index, step, effect, works_on)
            for effect in step.effects:
                if isinstance(effect, Unlid):
                    works_on = self._unlid(index, step, effect) or works_on
                elif isinstance(effect, Relid):
                    works_on = self._relid(index, step, effect) or works_on
                elif isinstance(effect, Move):
                    works_on = self._move(index, step, effect) or works_on
                elif isinstance(effect, Take):
                    works_on = self._take(index, step, effect)
            self._pipette(index, step, works_on)
            for effect in step.effects:
                if isinstance(effect, Sets):
                    if effect.of == "module":
                        self.variables.setdefault(step.module, {})[effect.variable] = effect.value
                    elif works_on is not None:
                        works_on.variables[effect.variable] = effect.value
            if after is not None:
                after(index)

    def outputs(self) -> tuple[StationName, ...]:
        """Where the run's labware stands at its end; once a piece."""
        return tuple(name for name, pieces in self.at.items() for _ in pieces)

    # -- effects -----------------------------------------------------------------------------

    def _works_on(self, step: PlanStep) -> Piece | None:
        for effect in step.effects:
            place = self._source(effect)
            if place and self.at.get(place):
                return self.at[place][-1]
        here = [piece for station in self._of(step) for piece in self.at.get(station.name, [])]
        return here[-1] if here else None

    @staticmethod
    def _source(effect: AnyEffect) -> StationName:
        if isinstance(effect, Move):
            return effect.source
        return effect.station if isinstance(effect, Needs) else StationName("")

    def _of(self, step: PlanStep) -> list[StationSpec]:
        return [station for station in self.stations.of(step.module) if station.kind != "gripper"]

    def _needed(self, index: int, step: PlanStep, effect: Needs) -> Piece | None:
        if effect.station:
            return self._labware_at(index, effect.station)
        places = self._of(step)
        for station in places:
            if self.at.get(station.name):
                return self.at[station.name][-1]
        if len(places) == 1:
            return self._labware_at(index, places[0].name)
        if places:
            self.warning(
                index,
                f"{step.action} needs labware on {local(step.module)}, and no step before puts any there.",
                "It must stand there when the run starts; else move some there first.",
            )
            if places[0].name not in {place for place, _ in self.taken}:
                self.taken.append((places[0].name, Piece("", fresh=False)))
        else:
            self.error(
                index,
                f"{step.action} needs labware, and {local(step.module)} has no station.",
                "Add a station of the module under `stations:` in the workcell.",
            )
        return None

    def _labware_at(self, index: int, place: StationName) -> Piece | None:
        """The run's piece at a place; one that must stand there from the start, if there is none."""
        pieces = self.at.setdefault(place, [])
        if pieces:
            return pieces[-1]
        station = self.stations[place]
        if station.kind == "waste":
            self.error(index, f"Nothing can be taken out of {local(place)}.", "Name another station.")
            return None
        if (place in self.inputs or place in self.left) and not station.is_storage:
            self.error(
                index,
                f"There is no labware of this run at {local(place)} any more.",
                "An earlier step took it away; name where it is now, or move some there first.",
            )
            return None
        self.inputs.append(place)
        piece = Piece(self.stock.get(place, ""), fresh=station.kind == "stack")
        pieces.append(piece)
        self.taken.append((place, piece))
        return piece

    def _require(self, index: int, step: PlanStep, effect: Requires, piece: Piece | None) -> None:
        if effect.of == "module":
            variables = self.variables.setdefault(step.module, {})
            value = variables.get(effect.variable, UNKNOWN)
            who = local(step.module)
            if value is UNKNOWN:
                variables[effect.variable] = effect.value
        else:
            value = piece.variable(effect.variable) if piece else UNKNOWN
            who = "the labware"
            if piece and value is UNKNOWN:
                piece.variables[effect.variable] = piece.at_first[effect.variable] = effect.value
        if value is not UNKNOWN and value != effect.value:
            self.error(
                index,
                f"{step.action} needs {_said(who, effect.variable, effect.value)},"
                f" but then {_said(who, effect.variable, value)}.",
                "Add a step before that changes it, or leave this step out.",
            )

    def _pipette(self, index: int, step: PlanStep, piece: Piece | None) -> None:
        """What goes into wells fits into them, and what is drawn is there. Lists that do not fit one another
        were told before."""
        if piece is None:
            return
        kind = self.labware.get(piece.kind)
        fault = misfit(step.effects, kind, piece.volumes_ul, "the labware") if kind is not None else ""
        if fault:
            message = f"{fault[0].upper()}{fault[1:]}."
            self.error(
                index,
                message,
                "Pour into a well what fits, and draw what is there.",
            )
            return
        for effect in step.effects:
            with suppress(ValueError):
                if isinstance(effect, Transfers | Draws):
                    note = add_doses if isinstance(effect, Transfers) else draw_doses
                    for well, volume in doses_of(effect):
                        note(piece.volumes_ul, [well], [volume])

    def _take(self, index: int, step: PlanStep, effect: Take) -> Piece:
        stack = self.stations[effect.stack]
        if stack.kind not in ("stack", "hotel"):
            self.error(index, f"{local(effect.stack)} is no stack.", "Name a stack to take from.")
        self._hand_free(index, step, effect.stack)
        self._reachable(index, step, effect.stack, "")
        self._draw(index, effect.stack)
        if self.stations[effect.target].kind == "waste":
            self.error(
                index,
                f"What comes off a stack gets its name where it is put down: not in {local(effect.target)}.",
                "Take it to a station first, and discard it in a step after that.",
            )
        piece = Piece(self.stock.get(effect.stack, ""), fresh=True)
        self._put(index, step, effect.target, piece, "")
        return piece

    def _draw(self, index: int, stack: StationName) -> None:
        """Count what is taken, where it is known what there is; it may be refilled meanwhile."""
        if self.counts is None:
            return
        left = self.counts.get(stack, 0)
        self.counts[stack] = max(left - 1, 0)
        if not left:
            self.missing.append(stack)
            self.warning(
                index,
                f"The stack {local(stack)} is empty by then; the step will wait.",
                f"Fill it and say so: labos load {local(stack)} --type TYPE --count N --lot LOT",
            )

    def _move(self, index: int, step: PlanStep, effect: Move) -> Piece | None:
        piece = self._labware_at(index, effect.source)
        self._hand_free(index, step, effect.source)
        self._open(index, effect.source)
        self._reachable(index, step, effect.source, effect.source_grip, piece.kind if piece else "")
        if effect.via:
            self._reachable(index, step, effect.via, "")
        self._told_apart(index, step, effect.source)
        if effect.source == effect.target:
            self.error(
                index,
                f"The labware is moved from {local(effect.source)} to where it stands.",
                "Name another target.",
            )
            return piece
        if piece is None:
            return None
        self.at[effect.source].remove(piece)
        self.left.add(effect.source)
        if self.stations[effect.target].kind == "waste":
            self._discarded(index, piece)
        self._turn(index, effect, piece)
        self._put(index, step, effect.target, piece, effect.target_grip)
        return piece

    def _told_apart(self, index: int, step: PlanStep, place: StationName) -> None:
        """An arm goes to one pose: of several pieces at one station it takes any."""
        station = self.stations[place]
        several = station.kind == "hotel" and station.capacity > 1 and not self.stations.shelves(place)
        if several and station.module != step.module:
            self.warning(
                index,
                f"{local(place)} holds {station.capacity} pieces, and {local(step.module)} was taught one "
                "place there: it takes what stands at it, whosever it is.",
                f"Write `shelves: {station.capacity}` instead of its capacity, and teach them.",
            )

    def _unlid(self, index: int, step: PlanStep, effect: Unlid) -> Piece | None:
        plate = self._labware_at(index, effect.source)
        self._open(index, effect.source)
        self._reachable(index, step, effect.source, effect.source_grip)
        self._apart(index, effect)
        if plate is None:
            return None
        if plate.variable("lidded") is False:
            self.error(
                index,
                f"The labware at {local(effect.source)} has no lid to take off.",
                "Leave this step out, or stock plates with lids (`plate96+lid96`).",
            )
        if plate.variable("lidded") is UNKNOWN:
            plate.at_first["lidded"] = True
        lid = plate.lid or Piece("", fresh=plate.fresh)
        plate.lid, plate.parked = None, effect.target
        plate.variables["lidded"] = False
        self._put(index, step, effect.target, lid, effect.target_grip)
        return plate

    def _relid(self, index: int, step: PlanStep, effect: Relid) -> Piece | None:
        lid = self._labware_at(index, effect.source)
        plate = self._labware_at(index, effect.target)
        for place, grip in ((effect.source, effect.source_grip), (effect.target, effect.target_grip)):
            self._open(index, place)
            self._reachable(index, step, place, grip)
        self._apart(index, effect)
        if lid is None or plate is None:
            return plate
        if plate.variable("lidded") is True:
            self.error(
                index,
                f"The labware at {local(effect.target)} has a lid already.",
                "Take it off in a step before, or leave this step out.",
            )
        self.at[effect.source].remove(lid)
        for pieces in self.at.values():
            for piece in pieces:
                if piece.parked == effect.source:
                    piece.parked = None
        plate.lid = lid
        plate.variables["lidded"] = True
        return plate

    def _apart(self, index: int, effect: Unlid | Relid) -> None:
        if effect.source == effect.target:
            self.error(
                index,
                f"The lid and its plate cannot both be at {local(effect.source)}.",
                "Name another place for the lid.",
            )

    def _turn(self, index: int, effect: Move, piece: Piece) -> None:
        """Which way round it comes to lie; of what came from nowhere it is not known."""
        before = piece.variables.get("a1", 0 if piece.fresh else UNKNOWN)
        if before is UNKNOWN:
            return
        source, target = self.stations[effect.source], self.stations[effect.target]
        way = (before + turn(effect, source.rotation, target.rotation)) % 360
        piece.variables["a1"] = way
        if target.a1 is not None and way != target.a1:
            self.error(
                index,
                f"The labware would lie turned by {way} degrees at {local(effect.target)}, "
                f"which takes it turned by {target.a1}.",
                "Grip it narrow at one end and wide at the other, or not.",
            )

    def _discarded(self, index: int, piece: Piece) -> None:
        """A plate goes to waste: its lid must not stay behind where others need the room."""
        if piece.parked is not None and self.at.get(piece.parked):
            self.error(
                index,
                f"The plate is discarded, and its lid stays behind at {local(piece.parked)}.",
                "Put the lid back on, or discard it in a step before.",
            )

    def _put(self, index: int, step: PlanStep, place: StationName, piece: Piece, grip: str) -> None:
        station = self.stations[place]
        self._open(index, place)
        self._reachable(index, step, place, grip, piece.kind)
        here = self.at.setdefault(place, [])
        self.left.discard(place)
        if station.kind != "waste" and len(here) >= station.capacity:
            self.error(
                index,
                f"{local(place)} is full: labware of this run already stands there.",
                "Move it away in a step before.",
            )
        if piece.kind and not station.admits(piece.kind):
            stacked = piece.kind in station.refuses
            self.error(
                index,
                f"{local(place)} does not accept {piece.kind}.",
                "One may not stand upon another." if stacked else f"It accepts {', '.join(station.accepts)}.",
            )
        here.append(piece)

    # -- checks ------------------------------------------------------------------------------

    def _open(self, index: int, place: StationName) -> None:
        """The owner of a station lets an arm in."""
        station = self.stations[place]
        if not station.module:
            return
        variables = self.variables.get(station.module, {})
        for variable, wanted in station.access.items():
            value = variables.get(variable, UNKNOWN)
            if value is not UNKNOWN and value != wanted:
                owner = local(station.module)
                self.error(
                    index,
                    f"{local(place)} is out of reach: {_said(owner, variable, value)}.",
                    f"Add a step before, so that {_said(owner, variable, wanted)}.",
                )

    def _hand_free(self, index: int, step: PlanStep, source: StationName) -> None:
        """An arm that holds labware only puts it down."""
        for station in self.stations.of(step.module):
            if station.kind == "gripper" and station.name != source and self.at.get(station.name):
                arm = local(step.module)
                self.error(
                    index, f"The hand of {arm} is full by then.", "Put down what it holds in a step before."
                )

    def _reachable(self, index: int, step: PlanStep, place: StationName, grip: str, kind: str = "") -> None:
        """The acting arm was taught the place. Nothing is known of arms without any poses."""
        station = self.stations[place]
        if step.module not in self.taught or station.module == step.module:
            return
        grips = station.grips(step.module, kind) if step.module in station.reach else None
        arm, where = local(step.module), local(place)
        if grips is None:
            self.error(
                index,
                f"{arm} was never taught {where}.",
                f"Add it under `locations: {arm}:` in the workcell, or use another station.",
            )
        elif grips and grip and grip not in grips:
            what = f"{kind} {grip}" if kind in station.reach_of else grip
            self.error(index, f"{arm} cannot grip {what} at {where}.", f"It can grip {', '.join(grips)}.")


def _said(who: str, variable: str, value: Any) -> str:
    """``the labware not sealed``, ``lid of biometra open``."""
    if isinstance(value, bool):
        return f"{who} {variable}" if value else f"{who} not {variable}"
    return f"{variable} of {who} {value}"
