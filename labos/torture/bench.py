"""The bench of one driver under torture: the labware that is put there, and the true motions. Only devices
and people write the motion log of the world. The reports of a node are compared with it.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Mapping

import msgspec

from labos.core.effects import (
    AnyEffect,
    Carrying,
    Move,
    Needs,
    Relid,
    Requires,
    Take,
    Unlid,
    is_reported,
    resolve,
)
from labos.core.ids import StationName
from labos.core.model import ActionSpec, Description
from labos.node.node import Setup
from labos.node.torture import Case
from labos.node.world import Motion, World, lid_of

PLATE, LID = "plate96", "lid96"
PEOPLE = ("person", "bench", "somebody")
SCENERY = ("enter", "leave", "furnish", "share", "fit", "lie", "label", "supply")
GATES = ("shut", "open")
POLL_S = 0.02

Deeds = Counter[tuple[str, str]]
"""The number of times of each (verb, place)."""


class Bench:
    """The stations and labware around the module ``name``."""

    def __init__(self, world: World, name: str, about: Description) -> None:
        self.world, self.name, self.about = world, name, about
        self._setup = Setup(name=name, workcell="torture")

    def place(self, station: str) -> str:
        """The name of a station in the world: the full name for a station of another module; a gripper has
        one name."""
        if station == "gripper":
            return f"hand:{self.name}"
        return station if "." in station or ":" in station else self._setup.place(station)

    def effects(self, case: Case, spec: ActionSpec) -> tuple[AnyEffect, ...]:
        """The effects of the action with the arguments of the case. Effects that need a workflow (files,
        lists of volumes) are left out."""
        args = {arg.name: arg.default for arg in spec.args if not arg.required}
        args.update({find_name(spec, name): value for name, value in case.args.items()})
        found = []
        for effect in spec.effects:
            try:
                found.append(resolve(effect, args, StationName))
            except (KeyError, ValueError, AttributeError, TypeError, IndexError):
                continue
        return tuple(found)

    # -- people ------------------------------------------------------------------------------

    def clear(self) -> None:
        """A person takes all plates and lids away."""
        for plates in self.world.list_contents().values():
            for plate in plates:
                self.world.carry(plate, "")

    def lay(self, case: Case, spec: ActionSpec) -> None:
        """Put only the labware on the bench that the action needs."""
        self.clear()
        for station, kind in case.stock.items():
            self._stock(station, kind)
        if not case.stock:
            self._furnish(self.effects(case, spec))

    def _furnish(self, effects: tuple[AnyEffect, ...]) -> None:
        lidded = any(isinstance(e, Requires) and (e.variable, e.value) == ("lidded", True) for e in effects)
        plate = f"{PLATE}+{LID}" if lidded else PLATE
        for effect in effects:
            match effect:
                case Unlid(source=source):
                    self._stock(source, f"{PLATE}+{LID}")
                case Relid(source=source, target=target):
                    self._stock(source, LID)
                    self._stock(target, PLATE)
                case Move(source=place) | Take(stack=place):
                    self._stock(place, plate)
                case Needs(station=here):
                    self._stock(here or self._find_own_station(), plate)
        for effect in effects:
            if isinstance(effect, Requires) and effect.of == "labware" and effect.variable == "sealed":
                for full in self.world.list_contents() if effect.value else ():
                    self.world.work("somebody", "seal", full)

    def _stock(self, place: str, kind: str) -> None:
        where = self.place(place)
        if self.world.at(where):
            return
        if where.startswith("hand:"):
            (plate,) = self.world.stock("bench.floor", kind)
            self.world.carry(plate, where)
        else:
            self.world.stock(where, kind)

    def _find_own_station(self) -> str:
        return next((s.name for s in self.about.stations if s.kind != "gripper"), "default")

    # -- motions -----------------------------------------------------------------------------

    def mark(self) -> int:
        """The end of the motion log now."""
        return self.world.last_motion()

    def motions(self, since: int) -> list[Motion]:
        """The motions of the module's device after a mark."""
        return [m for m in self.world.motions(after=since) if m.device not in PEOPLE]

    def list_deeds(self, since: int, *, gates: bool) -> Deeds:
        """Count what it did: plates and liquids moved, work done; with ``gates`` doors, too."""
        passed_over = SCENERY if gates else SCENERY + GATES
        return Counter((m.verb, m.place) for m in self.motions(since) if m.verb not in passed_over)

    async def await_quiet(self, still_s: float, limit_s: float = 60.0) -> bool:
        """Wait until nothing has moved for this time; False if the device never comes to rest."""
        began = since = time.monotonic()
        seen = self.mark()
        while (now := time.monotonic()) - since < still_s:
            if now - began > limit_s:
                return False
            await asyncio.sleep(POLL_S)
            if (fresh := self.mark()) != seen:
                seen, since = fresh, time.monotonic()
        return True

    # -- where labware is --------------------------------------------------------------------

    def find_subject(self, effect: AnyEffect) -> str:
        """The plate or lid that an effect will move, found by its place."""
        match effect:
            case Unlid(source=source):
                plates = self.world.at(self.place(source))
                lids = self.world.at(lid_of(plates[-1])) if plates else []
                return lids[-1] if lids else ""
            case Move(source=place) | Take(stack=place):
                plates = self.world.at(self.place(place))
                return plates[-1] if plates else ""
        return ""

    def find_place(self, plate: str) -> str:
        """The place of a plate; empty if it is out of the lab."""
        return next((place for place, plates in self.world.list_contents().items() if plate in plates), "")

    def find_misplaced(self, case: Case, effect: AnyEffect, plate: str) -> str:
        """The error in the place of a plate after an action that moved it; empty if there is none."""
        if not plate or not isinstance(effect, Carrying):
            return ""
        here, target = self.find_place(plate), self.place(case.ends or effect.target)
        if effect.lid == "on":
            beneath = self.world.at(target)
            target = lid_of(beneath[0]) if beneath else target
        if here == target or (here == "" and target.rpartition(".")[2] in ("trash", "waste")):
            return ""
        return f"according to its effects the labware stands at {target}; it is {here or 'nowhere'}"


def find_name(spec: ActionSpec, name: str) -> str:
    """The declared name of an argument, found by this name or an alias."""
    return next((arg.name for arg in spec.args if name == arg.name or name in arg.aliases), name)


def is_unresolved(effect: AnyEffect) -> bool:
    """Whether an effect still has placeholders that the arguments should have replaced."""
    values = msgspec.structs.asdict(effect).values()
    return any(isinstance(v, str) and "{" in v and not is_reported(v) for v in values)


def find_repeated(deeds: Deeds, expected: Deeds) -> Deeds:
    """The expected motions that were made more often than expected, with the number of times."""
    return Counter({deed: n for deed, n in deeds.items() if deed in expected and n > expected[deed]})


def describe_deeds(deeds: Mapping[tuple[str, str], int]) -> str:
    """The motions as text."""
    words = [
        f"{verb}{f' at {place}' if place else ''}{f' ({n} times)' if n > 1 else ''}"
        for (verb, place), n in sorted(deeds.items())
    ]
    return ", ".join(words) or "nothing"
