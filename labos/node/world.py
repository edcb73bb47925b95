"""The simulated bench: the real events there, separate from LabOS' own state.

A world is a log of motions in an SQLite file. Simulated devices write it, LabOS never does. It has places,
plates, hands and gates, but no effects, events or occupancy. So a test can compare it with the log, and they
cannot agree merely by construction. Devices in several processes share one file; in the seeded simulation it
is in memory.
"""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import msgspec

FLOOR = "floor"
"""The place of plates that fell down: no hand can reach it."""

MISHAPS = ("misses", "drops", "keeps")
"""Unnoticed faults of a hand: its fingers close beside the plate, lose the plate on the way, or do not
release it."""


class Crash(Exception):
    """An event on the bench that must never happen: a plate on a plate, a hand in a closed gate, a grip
    without a plate."""


class Motion(msgspec.Struct, frozen=True):
    """One real motion or operation of a device."""

    seq: int
    device: str
    verb: str
    place: str
    plate: str
    facts: dict[str, Any]


def lid_of(plate: str) -> str:
    """The place on a plate where its lid lies; the world treats a lid as a plate."""
    return f"lid:{plate}"


class World:
    """Plates at places. The names of places are those that the devices were taught."""

    def __init__(self, path: str = ":memory:") -> None:
        self.path = path
        self._db = sqlite3.connect(path, isolation_level=None, timeout=30, check_same_thread=False)
        # The bench outlives its processes, not the machine: no sync is needed.
        self._db.executescript(
            "PRAGMA synchronous=OFF;"
            "CREATE TABLE IF NOT EXISTS motion (seq INTEGER PRIMARY KEY, device TEXT, verb TEXT,"
            " place TEXT, plate TEXT, facts TEXT);"
        )
        self._lock = threading.Lock()
        self._seen = 0
        self._done: dict[str, dict[str, int]] = {}
        self._plates: dict[str, list[str]] = {}
        self._kinds: dict[str, str] = {}
        self._labels: dict[str, str] = {}
        self._capacity: dict[str, int] = {}
        self._thrown: dict[str, int] = {}
        self._shut: set[str] = set()
        self._zones: dict[str, str] = {}
        self._inside: dict[str, set[str]] = {}
        self._supplies: dict[str, dict[str, float]] = {}
        self._frames: dict[str, int] = {}
        self._only: dict[str, int | None] = {}
        self._ways: dict[str, int] = {}
        self._held: dict[str, str] = {}
        self._from: dict[str, str] = {}
        self._fits: dict[tuple[str, str], list[str]] = {}
        self._trips: dict[str, list[str]] = {}

    def close(self) -> None:
        self._db.close()

    # -- setting the scene -------------------------------------------------------------------

    def furnish(self, place: str, capacity: int = 1) -> None:
        """Add a place with room for a number of plates."""
        self._act("bench", "furnish", place, capacity=capacity)

    def share(self, zone: str, *places: str) -> None:
        """Make a zone: hands that reach for these places, and devices of these names that work, can
        collide."""
        with self._turn():
            for place in places:
                if self._zones.get(place) != zone:
                    self._record("bench", "share", place, "", {"zone": zone})

    def stock(self, place: str, kind: str, count: int = 1) -> list[str]:
        """A person puts fresh plates at a place, on top of those there, with lids if the kind has one
        (``plate96+lid96``). Returns the plates."""
        with self._turn():
            kind, _, lid = kind.partition("+")
            first = sum(not plate.startswith("lid of") for plate in self._kinds) + 1
            fresh = [f"plate{first + number}" for number in range(count)]
            for plate in fresh:
                self._record("person", "stock", place, plate, {"kind": kind})
                if lid:
                    self._record("person", "stock", lid_of(plate), f"lid of {plate}", {"kind": lid})
            return fresh

    def fit(self, place: str, kind: str, *grips: str) -> None:
        """Set the only possible grips for plates of a kind at a place."""
        self._act("bench", "fit", place, kind=kind, grips=grips)

    def lie(self, place: str, frame: int = 0, only: int | None = None) -> None:
        """Set the rotation of a nest in the room, and the only rotation in which it accepts plates
        (degrees)."""
        self._act("bench", "lie", place, frame=frame, only=only)

    def way(self, plate: str) -> int:
        """The rotation of a plate in its nest (degrees)."""
        with self._turn():
            return self._ways.get(plate, 0)

    def is_full(self, place: str) -> bool:
        """Whether no plate can be put there."""
        with self._turn():
            return len(self._list_here(place)) >= self._capacity.get(place, 1)

    def carry(self, plate: str, target: str) -> None:
        """A person carries a plate to a place (``""`` for out of the lab)."""
        self._act("person", "carry", target, plate)

    def empty(self, place: str) -> None:
        """A person empties a waste chute."""
        self._act("person", "empty", place)

    def trip(self, device: str, how: str) -> None:
        """The next motion of a hand goes wrong (``misses``, ``drops`` or ``keeps``), and the hand does not
        notice it."""
        self._act("bench", "trip", device, how=how)

    def label(self, plate: str, text: str) -> None:
        """A person puts a barcode on a plate (``""``: removes it)."""
        self._act("person", "label", "", plate, text=text)

    def supply(self, device: str, resource: str, amount: float) -> None:
        """A person puts an amount of a resource into a device. A resource that was never supplied is
        unlimited."""
        self._act("person", "supply", device, resource=resource, amount=amount)

    # -- what devices do ---------------------------------------------------------------------

    def grip(self, device: str, place: str, how: str = "") -> str:
        """The device's hand takes the topmost plate from a place, ``how`` (``narrow`` or ``wide``;
        empty: as it fits); returns the plate."""
        with self._turn():
            self._reach(device, place)
            if not self._list_here(place):
                self._crash(device, place, "grips empty air")
            if self._list_here(f"hand:{device}"):
                self._crash(device, place, "grips with a full hand")
            plate = self._list_here(place)[-1]
            self._get_round(device, place, plate, how)
            self._record(device, "grip", place, plate, {"how": how})
            return plate

    def release(self, device: str, place: str, how: str = "") -> str:
        """The device's hand puts its plate down; returns the plate."""
        with self._turn():
            self._reach(device, place)
            held = self._list_here(f"hand:{device}")
            if not held:
                self._crash(device, place, "releases nothing")
            if len(self._list_here(place)) >= self._capacity.get(place, 1):
                self._crash(device, place, "puts a plate on a plate")
            plate = held[-1]
            self._get_round(device, place, plate, how)
            way = self._compute_way(place, plate, how)
            if self._only.get(place) not in (None, way):
                self._crash(device, place, "sets a plate crosswise into its nest")
            self._record(device, "release", place, plate, {"how": how, "way": way})
            return plate

    def discard(self, device: str, place: str) -> str:
        """The device's hand drops its plate into a waste chute; returns the plate."""
        with self._turn():
            held = self._list_here(f"hand:{device}")
            if not held:
                self._crash(device, place, "discards nothing")
            if place in self._capacity and self._thrown.get(place, 0) >= self._capacity[place]:
                self._crash(device, place, "throws a plate into a full chute")
            plate = held[-1]
            self._record(device, "discard", place, plate, {})
            return plate

    def mishap(self, device: str) -> str:
        """The fault of the motion that a hand begins now; empty if there is none."""
        with self._turn():
            if not self._trips.get(device):
                return ""
            how = self._trips[device][0]
            self._record(device, "stumble", device, "", {"how": how})
            return how

    def drop(self, device: str) -> str:
        """The plate in the device's hand falls to the floor. Returns the plate; empty if there was none."""
        with self._turn():
            held = self._list_here(f"hand:{device}")
            if not held:
                return ""
            plate = held[-1]
            self._record(device, "drop", FLOOR, plate, {})
            return plate

    def enter(self, device: str, place: str) -> None:
        """The device moves to a place. It crashes if another device is in the same zone."""
        with self._turn():
            zone = self._zones.get(place, "")
            if not zone or zone in self._inside.get(device, ()):
                return
            for other, zones in self._inside.items():
                if zone in zones:
                    self._crash(device, place, f"hits {other}")
            self._record(device, "enter", place, "", {})

    def leave(self, device: str) -> None:
        """The device has left its zone."""
        with self._turn():
            if self._inside.get(device):
                self._record(device, "leave", "", "", {})

    def gate(self, device: str, place: str, *, shut: bool) -> None:
        """A lid or drawer in front of a place opens or closes."""
        self._act(device, "shut" if shut else "open", place)

    def work(self, device: str, verb: str, place: str = "", **facts: Any) -> str:
        """The device works on the topmost plate at a place (on nothing, if no place is named). Returns the
        plate. It crashes if the place is empty."""
        with self._turn():
            plate = ""
            if place:
                if not self._list_here(place):
                    self._crash(device, place, f"would {verb} a plate that is not there")
                plate = self._list_here(place)[-1]
            self._record(device, verb, place, plate, facts)
            return plate

    def use(self, device: str, resource: str, amount: float) -> None:
        """The device uses up an amount. It crashes if less is left."""
        with self._turn():
            left = self._supplies.get(device, {}).get(resource)
            if left is not None and amount > left:
                self._crash(device, device, f"runs out of {resource}")
            self._record(device, "use", device, "", {"resource": resource, "amount": amount})

    def crash(self, device: str, place: str, what: str) -> NoReturn:
        """The device causes damage that only it can detect; always raises Crash."""
        with self._turn():
            self._crash(device, place, what)

    # -- looking -----------------------------------------------------------------------------

    def at(self, place: str) -> list[str]:
        """The plates at a place, bottom to top; ``hand:<device>`` is a device's hand."""
        with self._turn():
            return list(self._list_here(place))

    def kind(self, plate: str) -> str:
        with self._turn():
            return self._kinds.get(plate, "")

    def barcode(self, plate: str) -> str:
        """The barcode of a plate; plates have one from the factory."""
        with self._turn():
            return self._labels.get(plate, f"LB{plate.removeprefix('plate'):0>6}")

    def last(self, plate: str, *verbs: str) -> str:
        """The last of these verbs that happened to a plate; empty if none did."""
        with self._turn():
            done = self._done.get(plate, {})
            return max((verb for verb in verbs if verb in done), key=lambda verb: done[verb], default="")

    def contents(self, plate: str) -> dict[str, dict[str, float]]:
        """The liquids that were really pipetted into a plate and not drawn again: µL by well and liquid."""
        with self._turn():
            found: dict[str, dict[str, float]] = {}
            for motion in self._read("verb = 'pipette' AND plate = ?", plate):
                facts = motion.facts
                wells = facts.get("wells") or []
                for liquid, doses in (facts.get("volumes") or {}).items():
                    for well, dose in zip(wells, doses or [], strict=False):
                        amounts = found.setdefault(well, {})
                        amounts[liquid] = amounts.get(liquid, 0.0) + dose
                for well, dose in (facts.get("drawn") or {}).items():
                    amounts = found.get(well, {})
                    level = sum(amounts.values())
                    for liquid in amounts if level else ():
                        amounts[liquid] *= max(1.0 - dose / level, 0.0)
            return found

    def history(self, plate: str, *verbs: str) -> list[Motion]:
        """The motions of a plate with these verbs, in order."""
        return [motion for motion in self._read("plate = ?", plate) if motion.verb in verbs]

    def is_shut(self, place: str) -> bool:
        """Whether a closed lid or drawer blocks a place."""
        with self._turn():
            return place in self._shut

    def find_level(self, device: str, resource: str) -> float | None:
        """The real amount of a resource in a device; None if it was never supplied."""
        with self._turn():
            return self._supplies.get(device, {}).get(resource)

    def is_furnished(self, place: str) -> bool:
        """Whether the capacity of a place was set."""
        with self._turn():
            return place in self._capacity

    def list_contents(self) -> dict[str, list[str]]:
        """All places with their plates, bottom to top."""
        with self._turn():
            return {place: list(plates) for place, plates in sorted(self._plates.items()) if plates}

    def last_motion(self) -> int:
        """The number of the last motion."""
        with self._turn():
            return self._seen

    def motions(self, verb: str = "", after: int = 0) -> list[Motion]:
        """The motions in order; with ``after``, only those after the motion of that number."""
        return [motion for motion in self._read("seq > ?", after) if verb in ("", motion.verb)]

    def crashes(self) -> list[Motion]:
        return self.motions("crash")

    # -- inside ------------------------------------------------------------------------------

    def _list_here(self, place: str) -> list[str]:
        return self._plates.get(place, [])

    def _reach(self, device: str, place: str) -> None:
        if place in self._shut:
            self._crash(device, place, "reaches into a closed gate")

    def _compute_way(self, place: str, plate: str, how: str) -> int:
        """The rotation of a plate at a place. Fingers approach from the front of the nest, so a plate that is
        held the other way lies crosswise."""
        held = self._held.get(plate, "")
        quarter = 0 if "" in (held, how) or held == how else 90 if how == "wide" else -90
        frames = self._frames.get(place, 0) - self._frames.get(self._from.get(plate, ""), 0)
        return (self._ways.get(plate, 0) + frames + quarter) % 360

    def _get_round(self, device: str, place: str, plate: str, how: str) -> None:
        fits = self._fits.get((place, self._kinds.get(plate, "")))
        if how and fits is not None and how not in fits:
            self._crash(device, place, f"rams its {how} fingers into a plate")

    def _crash(self, device: str, place: str, what: str) -> NoReturn:
        self._record(device, "crash", place, "", {"what": what})
        raise Crash(f"{device} {what} at {place}")

    @contextmanager
    def _turn(self) -> Iterator[None]:
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                self._catch_up()
                yield
            finally:
                # A crash is a fact too: its records stay.
                self._db.execute("COMMIT")

    def _catch_up(self) -> None:
        for motion in self._read("seq > ?", self._seen):
            self._apply(motion)

    def _read(self, condition: str, value: object) -> list[Motion]:
        rows = self._db.execute(f"SELECT * FROM motion WHERE {condition} ORDER BY seq", (value,)).fetchall()
        return [
            Motion(seq, device, verb, place, plate, json.loads(facts))
            for seq, device, verb, place, plate, facts in rows
        ]

    def _act(self, device: str, verb: str, place: str, plate: str = "", **facts: Any) -> None:
        """Record one motion by itself."""
        with self._turn():
            self._record(device, verb, place, plate, facts)

    def _record(self, device: str, verb: str, place: str, plate: str, facts: dict[str, Any]) -> None:
        cursor = self._db.execute(
            "INSERT INTO motion (device, verb, place, plate, facts) VALUES (?, ?, ?, ?, ?)",
            (device, verb, place, plate, json.dumps(facts)),
        )
        self._apply(Motion(int(cursor.lastrowid or 0), device, verb, place, plate, facts))

    def _apply(self, motion: Motion) -> None:
        self._seen = motion.seq
        place, plate = motion.place, motion.plate
        if plate:
            self._done.setdefault(plate, {})[motion.verb] = motion.seq
        match motion.verb:
            case "furnish":
                self._capacity[place] = motion.facts["capacity"]
            case "lie":
                self._frames[place], self._only[place] = motion.facts["frame"], motion.facts["only"]
            case "fit":
                self._fits[place, motion.facts["kind"]] = motion.facts["grips"]
            case "stock":
                self._kinds[plate] = motion.facts["kind"]
                self._put(plate, place)
            case "grip":
                self._from[plate] = place
                self._held[plate] = motion.facts["how"]
                self._put(plate, f"hand:{motion.device}")
            case "release":
                self._ways[plate] = motion.facts["way"]
                self._put(plate, place)
            case "carry" | "drop":
                self._put(plate, place)
            case "trip":
                self._trips.setdefault(place, []).append(motion.facts["how"])
            case "stumble":
                self._trips[place].pop(0)
            case "discard":
                self._put(plate, "")
                self._thrown[place] = self._thrown.get(place, 0) + 1
            case "empty":
                self._thrown[place] = 0
            case "share":
                self._zones[place] = motion.facts["zone"]
            case "enter":
                self._inside.setdefault(motion.device, set()).add(self._zones[place])
            case "leave":
                self._inside.pop(motion.device, None)
            case "supply" | "use":
                supplies = self._supplies.setdefault(place, {})
                sign = 1 if motion.verb == "supply" else -1
                resource = motion.facts["resource"]
                if motion.verb == "supply" or resource in supplies:
                    supplies[resource] = supplies.get(resource, 0.0) + sign * motion.facts["amount"]
            case "label":
                self._labels[plate] = motion.facts["text"]
            case "shut":
                self._shut.add(place)
            case "open":
                self._shut.discard(place)

    def _put(self, plate: str, place: str) -> None:
        for plates in self._plates.values():
            if plate in plates:
                plates.remove(plate)
        if place:
            self._plates.setdefault(place, []).append(plate)
        else:
            self._plates.pop(lid_of(plate), None)  # it leaves with its lid
