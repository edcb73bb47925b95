"""A bench of a few dictionaries, against which the lab is compared: where each plate really stands, where it
may stand by all that was said, what is in flight, and how far each run has come.

It knows nothing of events, effects or reservations. Places are names without their workcell; a plate that
is off the bench is in no dictionary.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

CELL = "cell"
ARMS = ("arm", "arm2")
MODULES = (*ARMS, "cam")
CAPACITY = {"a": 1, "b": 1, "c": 1, "cam.nest": 1, "hotel": 2, "arm.gripper": 1}
STORAGE = ("hotel",)
STACK, TRASH = "stack", "trash"

Outcome = Literal["done", "pending", "failed"]


class Step(NamedTuple):
    """What a module does: ``take`` something off the stack, ``move`` it, ``work`` on what stands at its own
    nest, or ``look`` at nothing in particular."""

    do: Literal["take", "move", "work", "look"]
    module: str
    source: str = ""
    target: str = ""
    via: str = ""
    after: tuple[int, ...] = ()

    @property
    def hand(self) -> str:
        return f"{self.module}.gripper"

    @property
    def carries(self) -> bool:
        return self.do in ("take", "move")

    @property
    def places(self) -> tuple[str, ...]:
        """Where the plate may be while nobody knows how far it came, its start first and its end last."""
        return tuple(p for p in (self.source, self.hand, self.via, self.target) if p)


class Run:
    """``status``: queued, active, cancelling, completed, failed or cancelled. ``doomed``: it will have failed
    when what is in flight has ended."""

    def __init__(self, user: str, plan: tuple[Step, ...]) -> None:
        self.user, self.plan = user, plan
        self.status, self.paused, self.doomed = "queued", False, False
        self.steps = ["pending"] * len(plan)

    @property
    def over(self) -> bool:
        return self.status in ("completed", "failed", "cancelled")

    @property
    def busy(self) -> bool:
        return "flying" in self.steps or "unknown" in self.steps


class Flight:
    """An action that has not ended. ``plate`` is the name that it has, or will have once it is off the stack;
    ``left``: it fell silent once, and its plate is wherever it was by then."""

    def __init__(self, run: str, index: int, step: Step, plate: str) -> None:
        self.run, self.index, self.step, self.plate = run, index, step, plate
        self.unknown, self.left = False, False


class DictBench:
    """``really`` is where plates stand, ``maybe`` where they may be by what was told; ``loose`` are plates
    that are off the stack and have no name yet, by the name that they will have."""

    def __init__(self, stock: int) -> None:
        self.stock = stock
        self.really: dict[str, str] = {}
        self.maybe: dict[str, set[str]] = {}
        self.owner: dict[str, str] = {}
        self.loose: dict[str, str] = {}
        self.lost: dict[str, Step] = {}
        """Takes that ended nobody knows how and that somebody is asked about, by the plate's name."""
        self.left: dict[str, list[str]] = {}
        """What runs had when they ended, by their names; for whoever looks to take away."""
        self.runs: dict[str, Run] = {}
        self.flying: dict[str, Flight] = {}
        self.halted: set[str] = set()
        self.away: set[str] = set()
        self.unready: set[str] = set()

    @property
    def is_hindered(self) -> bool:
        """Whether something is kept from starting anywhere but in a run of its own."""
        return bool(self.halted or self.away or self.unready)

    # -- what stands where ---------------------------------------------------------------------

    def at(self, place: str) -> list[str]:
        """What really stands at a place."""
        named = [plate for plate, here in self.really.items() if here == place]
        return named + [plate for plate, here in self.loose.items() if here == place]

    def find_place(self, plate: str) -> str:
        """Where a plate stands for all that was told; empty if that is more than one place."""
        (only, *more) = self.maybe[plate]
        return "" if more else only

    def room(self, place: str, *, beside: str = "") -> bool:
        """Whether one more finds room when everything in flight has arrived; ``beside`` does not count."""
        if place == TRASH:
            return True
        here = {*self.at(place), beside}
        coming = sum(place in (f.step.target, f.step.via) for f in self.flights() if f.plate not in here)
        return len(here - {beside}) + coming < CAPACITY.get(place, 1)

    def flights(self) -> Iterator[Flight]:
        return (flight for flight in self.flying.values() if flight.step.carries)

    def doubtful(self, place: str) -> bool:
        """Whether something may be there of which that is not sure."""
        unsure = (places for places in self.maybe.values() if len(places) > 1 or places == {"arm2.gripper"})
        lost = (step.places for step in self.lost.values())
        return any(place in places for places in (*unsure, *lost))

    def is_handled(self, plate: str) -> bool:
        """Whether an action carries a plate or works on it."""
        return any(flight.plate == plate for flight in self.flying.values())

    def list_own(self, run: str, place: str) -> list[str]:
        """Plates at a place that a run may use."""
        allowed = (f"run:{run}", f"user:{self.runs[run].user}", "shared")
        return [
            plate
            for plate in self.maybe
            if self.find_place(plate) == place and self.owner[plate] in allowed and not self.is_handled(plate)
        ]

    # -- what may start --------------------------------------------------------------------------

    def find_reason(self, run: str, index: int) -> str:
        """Why a step must not start, whatever stands on the bench; empty if it may."""
        what = self.runs[run]
        if what.over or what.paused or what.status == "cancelling":
            return f"{run} is {what.status}, paused: {what.paused}"
        step = what.plan[index]
        if what.steps[index] != "pending" or any(what.steps[before] != "done" for before in step.after):
            return "it is not its turn"
        if self.halted & {f"{CELL}/{step.module}", CELL, "*"} or step.module in self.away | self.unready:
            return f"nothing starts on {step.module}"
        if any(flight.step.module == step.module for flight in self.flying.values()):
            return f"{step.module} is at work"
        return ""

    def crash(self, run: str, step: Step, plate: str) -> str:
        """What would go wrong if a motion or a work of a plate began now; empty if nothing."""
        if step.do == "look":
            return ""
        if step.do != "take" and self.really.get(plate) != step.source:
            return f"{plate} is not at {step.source} but at {self.really.get(plate)}"
        if step.do != "take" and plate not in self.list_own(run, step.source):
            return f"{plate} is not for {run}"
        takes = [f.plate for f in self.flights() if f.step.do == "take"]
        if step.do == "take" and self.stock <= len(set(takes) - self.loose.keys()):
            return "the stack is empty"
        if not step.carries:
            return ""
        full = [place for place in (step.target, step.via) if place and not self.room(place)]
        held = self.at(step.hand)
        return f"{full} is occupied" if full else f"the hand holds {held}" if held else ""

    def may_start(self, run: str, index: int) -> bool:
        """Whether nothing at all speaks against a start, so that it must be allowed."""
        step = self.runs[run].plan[index]
        if self.find_reason(run, index):
            return False
        touched = {place for flight in self.flying.values() for place in flight.step.places}
        if any(place.startswith(f"{step.module}.") for place in touched):
            return False  # somebody reaches in there
        if step.do == "look":
            return True
        if step.do == "take":
            taking = sum(flight.step.do == "take" for flight in self.flights())
            if self.doubtful(STACK) or self.stock + len(self.loose) <= taking:
                return False
        elif not self.list_own(run, step.source):
            return False
        if not step.carries:
            return True
        if self.doubtful(step.hand) or any(self.find_place(plate) == step.hand for plate in self.maybe):
            return False
        modules = {flight.step.module for flight in self.flying.values()}
        reached = {place.partition(".")[0] for place in (step.source, step.target, step.via) if "." in place}
        ends = [place for place in (step.target, step.via) if place]
        return not reached & (modules | self.unready) and all(
            self.room(p) and not self.doubtful(p) for p in ends
        )

    # -- what happens ------------------------------------------------------------------------------

    def start(self, action: str, run: str, index: int, plate: str) -> None:
        what = self.runs[run]
        what.status, what.steps[index] = "active", "flying"
        self.flying[action] = Flight(run, index, what.plan[index], plate)
        if plate in self.owner:
            self.owner[plate] = f"run:{run}"

    def carry(self, step: Step, plate: str, place: str) -> None:
        """A plate gets to a place, whether anybody knows or not; empty: off the bench."""
        if step.do == "take" and plate not in self.really:
            self.stock += plate in self.loose
            self.loose.pop(plate, None)
            if place != STACK:
                self.stock -= 1
            if place not in (STACK, ""):
                self.loose[plate] = place
        elif place:
            self.really[plate] = place
        else:
            self.really.pop(plate, None)

    def find_left(self, flight: Flight) -> str:
        """Where the plate of an action is."""
        plate = flight.plate
        return self.loose.get(plate) or self.really.get(plate) or (STACK if flight.step.do == "take" else "")

    def tell(self, plate: str, *places: str, owner: str = "") -> None:
        """Where a plate may be now, by what was told; nowhere, or in the waste: it is off the bench."""
        if plate in self.loose:
            self.really[plate] = self.loose.pop(plate)
            self.owner[plate] = owner
        if places in ((), (TRASH,)):
            for known in (self.really, self.maybe, self.owner):
                known.pop(plate, None)
        else:
            self.maybe[plate] = set(places)

    def end(self, action: str, outcome: Outcome) -> None:
        """An action has ended, and what that means for its run."""
        flight = self.flying.pop(action)
        run = self.runs[flight.run]
        run.steps[flight.index] = outcome
        run.doomed |= outcome == "failed"
        if all(step == "done" for step in run.steps):
            self.finish(flight.run, "completed")
        elif outcome == "failed" or run.status == "cancelling":
            self.wind_up(flight.run)

    def wind_up(self, name: str) -> None:
        """A run ends as soon as nothing of it is in flight."""
        run = self.runs[name]
        run.status = "cancelling"
        if not run.busy:
            self.finish(name, "failed" if run.doomed else "cancelled")

    def finish(self, name: str, status: str) -> None:
        """A run is over, and what it had is its user's."""
        run = self.runs[name]
        run.status = status
        self.left[name] = [plate for plate, owner in self.owner.items() if owner == f"run:{name}"]
        self.owner.update(dict.fromkeys(self.left[name], f"user:{run.user}"))

    def cancel(self, name: str) -> None:
        run = self.runs[name]
        if run.busy:
            run.status = "cancelling"
        else:
            self.finish(name, "failed" if run.doomed else "cancelled")
