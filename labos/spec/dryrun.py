"""Carries out a plan's effects on a model: it follows the labware and finds faults.

The dry run does not consider other runs. If a step uses labware that the run has not brought there, this
labware must be there when the run starts: these stations are the plan's inputs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from labos.core.algebra import carry, check_effect, compute_settings_after
from labos.core.effects import (
    AnyEffect,
    Carrying,
    Claims,
    Consumes,
    Draws,
    Effect,
    Needs,
    Requires,
    Sets,
    Transfers,
    list_arrivals,
    list_carried,
    name_hand,
    turn,
)
from labos.core.ids import StationName, local
from labos.core.model import PlanStep
from labos.core.wells import add_doses, draw_doses, find_misfit, list_doses
from labos.spec.paper import UNKNOWN, Paper, Piece


class DryRunStep:
    """A step of a dry run: a store that reports all faults, and therefore never returns an obstacle. All
    requirements of a step are checked before any of its effects is carried out."""

    def __init__(self, paper: Paper, index: int, step: PlanStep) -> None:
        self.paper, self.index, self.step = paper, index, step
        self.at = paper.at
        self.subject = self._find_worked_on()
        self._found: dict[StationName, Piece | None] = {}
        self._hauls: list[tuple[Carrying, Piece | None, Piece | None]] = []
        self._hauled: Piece | None = None

    def carry_out(self) -> None:
        """Report the faults of the step, and carry out its effects on the model."""
        needs = [effect for effect in self.step.effects if isinstance(effect, Needs)]
        others = [effect for effect in self.step.effects if not isinstance(effect, Needs | Carrying)]
        for asked in (*needs, *others):  # the other effects may be about the labware that it needs
            check_effect(self, asked)
        for carried in list_carried(self.step.effects):
            check_effect(self, carried)
            self._hauls.append((carried, *self._find_carried(carried)))
        self._check_room_for_all()
        for what, piece, plate in self._hauls:
            self._carry(what, piece, plate)
        self._check_pipetting()
        for effect in self.step.effects:
            if isinstance(effect, Sets) and effect.of == "labware" and self.subject is not None:
                self.subject.variables[effect.variable] = effect.value
        after = compute_settings_after(self.step.effects)
        self.paper.variables.setdefault(self.step.module, {}).update(after.variables)

    def _add_error(self, message: str, remedy: str) -> None:
        self.paper.error(self.index, message, remedy)

    def _add_warning(self, message: str, remedy: str) -> None:
        self.paper.warning(self.index, message, remedy)

    def _find_worked_on(self) -> Piece | None:
        """The labware that the step takes or needs; otherwise the labware on its module."""
        for effect in self.step.effects:
            place = _find_station(effect)
            if place and self.at.get(place):
                return self.at[place][-1]
        own = self.paper.list_stations(self.step.module)
        here = [piece for station in own for piece in self.at.get(station.name, [])]
        return here[-1] if here else None

    # -- what is in the way ----------------------------------------------------------------------

    def stock(self, what: Carrying, stack: StationName) -> None:
        """Count the taken pieces if the stock is known; the stack may be refilled during the run."""
        if self.paper.stations[stack].kind not in ("stack", "hotel"):
            self._add_error(f"{local(stack)} is not a stack.", "Name a stack to take from.")
        if self.at.get(stack):
            self._add_error(
                f"Labware of this run lies on the stack {local(stack)}.", "Move it away in a step before."
            )
        counts = self.paper.counts
        if counts is None:
            return
        left = counts.get(stack, 0)
        counts[stack] = max(left - 1, 0)
        if not left:
            self.paper.missing.append(stack)
            self._add_warning(
                f"The stack {local(stack)} is empty by then; the step will wait.",
                f"Fill it and report that: labos load {local(stack)} --type TYPE --count N --lot LOT",
            )

    def check_presence(self, what: Carrying, place: StationName) -> None:
        used = [piece for _, piece, _ in self._hauls if piece is not None]
        self._found[place] = self.paper.find_labware_at(self.index, place, used)
        self._check_distinct_poses(what, place)

    def _check_distinct_poses(self, what: Carrying, place: StationName) -> None:
        """An arm moves to one pose: if several pieces are at a station, it takes any of them."""
        station = self.paper.stations[place]
        shelves = self.paper.stations.list_shelves(place)
        several = station.kind == "hotel" and station.capacity > 1 and not shelves and not what.lid
        if several and station.module != self.step.module:
            self._add_warning(
                f"{local(place)} holds {station.capacity} pieces, but {local(self.step.module)} was "
                "taught only one place there, so it could take labware of another run.",
                f"Write `shelves: {station.capacity}` instead of its capacity, and teach them.",
            )

    def check_fits(self, what: Carrying) -> None:
        piece, plate = self._find_carried(what)
        self._check_apart(what)
        if plate is not None:
            self._check_lid(what, plate, piece)
        kind = piece.kind if piece is not None else ""
        self._check_grip(what.source, what.source_grip, kind)
        self._check_grip(what.target, what.target_grip, kind)
        waste = self.paper.stations[what.target].kind == "waste"
        if waste and what.stock:
            self._add_error(
                "Labware from a stack gets its id where it is put down, which cannot be in "
                f"{local(what.target)}.",
                "Take it to a station first, and discard it in a step after that.",
            )
        if piece is None:
            return
        for place in what.room:
            self._check_type(place, kind)
        if not what.lid and not what.stock:
            self._turn_piece(what, piece)
            if waste:
                self._check_discard(piece)

    def _check_apart(self, what: Carrying) -> None:
        if what.source != what.target:
            return
        where = local(what.source)
        if what.lid:
            message = f"The lid and its plate cannot both be at {where}."
            self._add_error(message, "Name another place for the lid.")
        else:
            self._add_error(f"The labware is moved from {where} to the same place.", "Name another target.")

    def _check_lid(self, what: Carrying, plate: Piece, lid: Piece | None) -> None:
        where, lidded = local(what.plate_at), plate.find_variable("lidded")
        if what.lid == "off" and any(lid is other for _, other, _ in self._hauls):
            lidded = False
        if what.lid == "off" and lidded is False:
            self._add_error(
                f"The labware at {where} has no lid.",
                "Leave this step out, or stock plates with lids (`plate96+lid96`).",
            )
        elif what.lid == "off" and lidded is UNKNOWN:
            plate.at_first["lidded"] = True
        elif what.lid == "on" and lidded is True:
            self._add_error(
                f"The labware at {where} already has a lid.",
                "Take it off in a step before, or leave this step out.",
            )

    def _check_grip(self, place: StationName, grip: str, kind: str) -> None:
        """The acting arm can hold it so there. Places without a taught pose are not checked."""
        station, arm = self.paper.stations[place], self.step.module
        grips = station.list_grips(arm, kind) if self._was_taught(place) else ()
        if grips and grip and grip not in grips:
            what = f"{kind} {grip}" if kind in station.reach_of else grip
            self._add_error(
                f"{local(arm)} cannot grip {what} at {local(place)}.", f"It can grip {', '.join(grips)}."
            )

    def _check_type(self, place: StationName, kind: str) -> None:
        station = self.paper.stations[place]
        if kind and not station.admits(kind):
            stacked = kind in station.refuses
            self._add_error(
                f"{local(place)} does not accept {kind}.",
                "Pieces of this type cannot be stacked."
                if stacked
                else f"It accepts {', '.join(station.accepts)}.",
            )

    def _turn_piece(self, what: Carrying, piece: Piece) -> None:
        """The rotation of the piece after the motion; it stays unknown if it was unknown."""
        way, wanted = self._compute_a1(what, piece), self.paper.stations[what.target].a1
        if way is not UNKNOWN and wanted is not None and way != wanted:
            self._add_error(
                f"The labware would lie turned by {way} degrees at {local(what.target)}, "
                f"which takes it turned by {wanted}.",
                "Change the grip (narrow or wide) at one of the two ends.",
            )

    def _compute_a1(self, what: Carrying, piece: Piece) -> Any:
        before = piece.variables.get("a1", 0 if piece.fresh else UNKNOWN)
        if before is UNKNOWN:
            return UNKNOWN
        source, target = self.paper.stations[what.source], self.paper.stations[what.target]
        return (before + turn(what, source.rotation, target.rotation)) % 360

    def _check_discard(self, piece: Piece) -> None:
        """A plate goes to waste: its lid must not stay behind where others need the room."""
        if piece.parked is not None and self.at.get(piece.parked):
            self._add_error(
                f"The plate is discarded, but its lid stays at {local(piece.parked)}.",
                "Put the lid back on, or discard it in a step before.",
            )

    def check_hand(self, what: Carrying) -> None:
        hand, arm = name_hand(self.step.module), local(self.step.module)
        if what.source != hand and self.at.get(hand):
            self._add_error(f"The hand of {arm} is full by then.", "Put down what it holds in a step before.")

    def check_entry(self, what: Carrying, place: StationName) -> None:
        self._open(place)
        self._check_reachable(place)

    def _open(self, place: StationName) -> None:
        """The module of the station is open for an arm."""
        station = self.paper.stations[place]
        variables = self.paper.variables.get(station.module, {}) if station.module else {}
        for variable, wanted in station.access.items():
            value = variables.get(variable, UNKNOWN)
            if value is not UNKNOWN and value != wanted:
                owner = local(station.module)
                self._add_error(
                    f"{local(place)} is out of reach: {_describe_value(owner, variable, value)}.",
                    f"Add a step before, so that {_describe_value(owner, variable, wanted)}.",
                )

    def _check_reachable(self, place: StationName) -> None:
        """The acting arm was taught the place. Arms without any poses are not checked."""
        module = self.step.module
        if module not in self.paper.taught or self.paper.stations[place].module == module:
            return
        if not self._was_taught(place):
            arm, where = local(module), local(place)
            self._add_error(
                f"{arm} was never taught {where}.",
                f"Add it under `locations: {arm}:` in the workcell, or use another station.",
            )

    def _was_taught(self, place: StationName) -> bool:
        return self.step.module in self.paper.stations[place].reach

    def check_room(self, what: Effect, place: StationName) -> None:
        """Pieces that fit one by one also have to fit together: see ``_check_room_for_all``."""

    def _check_room_for_all(self) -> None:
        for place, number in Counter(list_arrivals(self.step.effects)).items():
            station = self.paper.stations[place]
            if station.kind != "waste" and len(self.at.get(place, ())) + number > station.capacity:
                self._add_error(
                    f"{local(place)} is full: labware of this run already stands there.",
                    "Move it away in a step before.",
                )

    def check_labware(self, needs: Needs) -> None:
        self.subject = self._find_needed(needs) or self.subject

    def _find_needed(self, needs: Needs) -> Piece | None:
        if needs.station:
            return self.paper.find_labware_at(self.index, needs.station)
        where, places = local(self.step.module), self.paper.list_stations(self.step.module)
        for station in places:
            if self.at.get(station.name):
                return self.at[station.name][-1]
        if len(places) == 1:
            return self.paper.find_labware_at(self.index, places[0].name)
        if not places:
            self._add_error(
                f"{self.step.action} needs labware, and {where} has no station.",
                "Add a station of the module under `stations:` in the workcell.",
            )
            return None
        self._add_warning(
            f"{self.step.action} needs labware on {where}, but no earlier step puts any there.",
            "It must be there when the run starts, or an earlier step must move some there.",
        )
        if places[0].name not in {place for place, _ in self.paper.taken}:
            self.paper.taken.append((places[0].name, Piece("", fresh=False)))
        return None

    def check_value(self, requires: Requires) -> None:
        piece = self.subject
        if requires.of == "module":
            variables = self.paper.variables.setdefault(self.step.module, {})
            value = variables.get(requires.variable, UNKNOWN)
            who = local(self.step.module)
            if value is UNKNOWN:
                variables[requires.variable] = requires.value
        else:
            value = piece.find_variable(requires.variable) if piece else UNKNOWN
            who = "the labware"
            if piece and value is UNKNOWN:
                piece.variables[requires.variable] = piece.at_first[requires.variable] = requires.value
        if value is not UNKNOWN and value != requires.value:
            self._add_error(
                f"{self.step.action} needs {_describe_value(who, requires.variable, requires.value)},"
                f" but then {_describe_value(who, requires.variable, value)}.",
                "Add a step before that changes it, or leave this step out.",
            )

    def check_setpoint(self, claims: Claims) -> None:
        """In a dry run no other run needs a different value."""

    def check_amount(self, consumes: Consumes) -> None:
        """In a dry run there is enough: the amounts are checked before a run is admitted."""

    # -- what it does ----------------------------------------------------------------------------

    def _find_carried(self, what: Carrying) -> tuple[Piece | None, Piece | None]:
        """The carried piece; and the plate, if the piece is a lid."""
        if what.stock:
            return Piece(self.paper.stock.get(what.stock, ""), fresh=True), None
        plate = self._found.get(what.plate_at) if what.lid else None
        if what.lid == "off":
            return (plate.lid or Piece("", fresh=plate.fresh) if plate is not None else None), plate
        return self._found.get(what.source), plate

    def lift(self, place: StationName) -> None:
        assert self._hauled is not None
        self.at[place].remove(self._hauled)
        self.paper.left.add(place)

    def put(self, place: StationName) -> None:
        assert self._hauled is not None
        self.at.setdefault(place, []).append(self._hauled)
        self.paper.left.discard(place)

    def _carry(self, what: Carrying, piece: Piece | None, plate: Piece | None) -> None:
        self.subject = plate or piece or self.subject
        if piece is None or (what.lid and plate is None) or (what.source == what.target and not what.lid):
            return
        if not what.lid and not what.stock and (way := self._compute_a1(what, piece)) is not UNKNOWN:
            piece.variables["a1"] = way
        if plate is not None:
            plate.variables["lidded"] = what.lid == "on"
            plate.lid = piece if what.lid == "on" else None
            if what.lid == "off":
                plate.parked = what.target
            else:
                self._forget_parked(what.source)
        self._hauled = piece
        carry(self, what)

    def _forget_parked(self, place: StationName) -> None:
        """The parked lid is on a plate again."""
        for pieces in self.at.values():
            for piece in pieces:
                if piece.parked == place:
                    piece.parked = None

    def _check_pipetting(self) -> None:
        """The liquids fit into their wells, and drawn liquids are there. Lists of different lengths were
        reported before."""
        piece, effects = self.subject, self.step.effects
        if piece is None:
            return
        kind = self.paper.labware.get(piece.kind)
        fault = find_misfit(effects, kind, piece.volumes_ul, "the labware") if kind is not None else ""
        if fault:
            message = f"{fault[0].upper()}{fault[1:]}."
            self._add_error(message, "Keep within the volume that the well can hold and contains.")
            return
        for effect in effects:
            with suppress(ValueError):
                if isinstance(effect, Transfers | Draws):
                    note = add_doses if isinstance(effect, Transfers) else draw_doses
                    for well, volume in list_doses(effect):
                        note(piece.volumes_ul, [well], [volume])


class DryRun(Paper):
    """The bench from the view of one run, and the effects of its steps on it."""

    def run(self, steps: Sequence[tuple[int, PlanStep]], after: Callable[[int], None] | None = None) -> None:
        """Carry out the steps in the given order. ``after`` is called after each of them."""
        is_conditional = any(step.when is not None for _, step in steps)
        for index, step in steps:
            if is_conditional:
                self.left.clear()
            DryRunStep(self, index, step).carry_out()
            if after is not None:
                after(index)


def _find_station(effect: AnyEffect) -> StationName:
    """The station at which an effect takes or needs labware with an id."""
    if isinstance(effect, Carrying):
        return StationName("") if effect.stock else effect.source
    return effect.station if isinstance(effect, Needs) else StationName("")


def _describe_value(who: str, variable: str, value: Any) -> str:
    """``the labware not sealed``, ``lid of biometra open``."""
    if isinstance(value, bool):
        return f"{who} {variable}" if value else f"{who} not {variable}"
    return f"{variable} of {who} {value}"
