"""Simulated arms of Hudson Robotics at the far end of a line.

They repeat each command, and answer it when it is done. Result codes other than 0000, 0002, 0014, 0021 and
1400 are invented. That a command waits for the end of a motion is invented too. Neither is published.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import ClassVar

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos.node.world import lid_of
from labos_drivers._hudson import END, Dialect, Joints, Sizes
from labos_drivers._onwire import OnLine
from labos_drivers._simulation import place_of

UNKNOWN_COMMAND, UNKNOWN_POINT, CRASHED, IN_ERROR = 1, 2, 1400, 14
HOME_S, FINGERS_S, SPOT = 28.0, 1.0, 1.5


class HudsonOnWire(OnLine):
    """The simulated arm. ``points`` are its taught points. ``homed``: it has been homed since it was switched
    on. ``is_slippery``: it drops a held plate during a motion."""

    dialect: ClassVar[Dialect]
    sizes: ClassVar[Sizes]
    points: ClassVar[dict[str, Joints]]
    stacks: ClassVar[tuple[str, ...]]
    speeds: ClassVar[Joints]
    code_of_data: ClassVar[str] = ""
    """What answers begin with."""

    def __init__(self, setup: Setup, end: FarEnd | None = None, *, homed: bool = True) -> None:
        super().__init__(setup, end)
        self.homed = homed
        self.error = 0
        self.at = Joints(0.0, self.sizes.travel_z, 0.0, self.sizes.retracted_y)
        # A gripper that held a plate when the power failed still holds it.
        self.fingers = "between" if self.find_held_plate() else "open"
        self.is_slippery = False
        self.stored = dict(self.points)
        self.is_in_motion = False
        self._percent = 10.0
        self._lines: deque[str] = deque()
        self.furnish(20, *self.stacks)
        own = {self.place(name): joints for name, joints in self.points.items()}
        taught = {
            place_of(setup, name): Joints.of(dict(zip(self.dialect.order, pose, strict=True)))
            for name, pose in setup.poses.items()
            if len(pose) == 4 and any(pose)
        }
        self._spots = own | taught
        self._stacks = {self.place(name) for name in self.stacks}

    # -- receiving ---------------------------------------------------------------------------

    def obey(self, line: str) -> None:
        self._lines.append(line)
        self._obey_all()

    def _obey_all(self) -> None:
        while self._lines and not self.is_in_motion:
            line = self._lines.popleft()
            self.send(line.encode() + END)
            try:
                self._obey(line)
            except (ValueError, IndexError):
                self._send_result(UNKNOWN_COMMAND)

    def _obey(self, line: str) -> None:
        name, _, rest = line.partition(" ")
        answers: dict[str, Callable[[], str]] = {
            "STATUS": lambda: f"{self.code_of_data}{int(self.homed)}",
            "VERSION": lambda: "2.07",
            "GETPOS": lambda: self.code_of_data + self.format_position(self.at),
            "GETGRIPPERISOPEN": lambda: str(self.fingers == "open").lower(),
            "GETGRIPPERISCLOSED": lambda: str(self.fingers == "shut").lower(),
        }
        moves = name in ("MOVE", "JOG", "OPEN", "CLOSE")
        if name in answers:
            self._send_data(answers[name]())
        elif name == "HOME":
            self._start_motion(HOME_S, self._home)
        elif moves and (self.error or not self.homed):
            self._send_result(self.error or IN_ERROR)
        elif name == "GETPOINT" and rest in self.stored:
            self._send_data(self.code_of_data + self.format_position(self.stored[rest]))
        elif name == "LOADPOINT":
            point, _, pose = rest.partition(",")
            self.stored[point] = self.dialect.read(pose)
            self._send_result(0)
        elif name == "DELETEPOINT" and rest in self.stored:
            del self.stored[rest]
            self._send_result(0)
        elif name == "MOVE" and rest in self.stored:
            self._go(self.stored[rest])
        elif name in ("MOVE", "DELETEPOINT", "GETPOINT"):
            self._send_result(UNKNOWN_POINT)
        elif name == "JOG":
            axis, _, distance = rest.partition(",")
            now = getattr(self.at, axis.lower(), 0.0)
            self._go(self.at.replace(**{axis.lower(): now + float(distance)}), jogs=True)
        elif name in ("SETSPEED", "SPEED"):
            self._percent = max(float(rest), 1.0)
            self._send_result(0)
        elif name in ("OPEN", "CLOSE"):
            self._start_motion(FINGERS_S, self._open if name == "OPEN" else self._close)
        else:
            self._send_result(UNKNOWN_COMMAND)

    # -- motions -----------------------------------------------------------------------------

    def _start_motion(self, lab_s: float, what: Callable[[], None]) -> None:
        self.is_in_motion = True
        self.world.enter(self.name, self.name)

        def end() -> None:
            what()
            self._finish(0)

        self.after(lab_s, end)

    def _finish(self, code: int) -> None:
        self.is_in_motion = False
        self._send_result(code)
        self._obey_all()

    def _go(self, target: Joints, *, jogs: bool = False) -> None:
        ways = zip(self.at.as_tuple(), target.as_tuple(), self.speeds.as_tuple(), strict=True)
        lab_s = max(abs(b - a) / speed for a, b, speed in ways) * 100 / self._percent + 0.2
        if place := self._find_place_under(target):
            self.world.enter(self.name, place)

        def arrive() -> None:
            self.at = self._stop_at_contact(target) if jogs else target
            if self.is_slippery and self.world.drop(self.name):
                self.fingers = "shut"
            if self.at.y <= self.sizes.retracted_y and self.at.z >= self.sizes.travel_z:
                self.world.leave(self.name)

        self._start_motion(lab_s, arrive)

    def _home(self) -> None:
        self.homed, self.error = True, 0
        self.at = Joints(0.0, self.sizes.travel_z, 0.0, self.sizes.retracted_y)
        self.world.leave(self.name)

    def _stop_at_contact(self, target: Joints) -> Joints:
        """The joints at which a jog ends: a descent over a stack ends when the hand touches the stack."""
        place = self._find_place_under(target)
        if place not in self._stacks or target.z > self.at.z:
            return target
        floor, unit = self._spots[place].z, self.dialect.unit
        bottom = floor + len(self.world.at(place)) * self.sizes.plate_mm * unit
        if self.find_held_plate():
            bottom += self.sizes.grip_mm * unit
        elif self.fingers == "open":
            bottom = floor
        return target.replace(z=max(target.z, bottom))

    def _close(self) -> None:
        place = self._find_spot()
        if self.find_held_plate():
            return
        if place and self.world.at(place):
            self.world.grip(self.name, place)
            self.fingers = "between"
        else:
            self.fingers = "shut"

    def _open(self) -> None:
        if self.find_held_plate():
            place = self._find_spot()
            if not place:
                self.world.crash(self.name, self.name, "drops a plate")
            self.open_hand(place)
        self.fingers = "open"

    def _find_place_under(self, joints: Joints) -> str:
        """The place that is below the hand at these joints; empty if there is none."""
        unit = self.dialect.unit
        for place, spot in self._spots.items():
            if max(abs(joints.r - spot.r), abs(joints.p - spot.p), abs(joints.y - spot.y)) < SPOT * unit:
                return place
        return ""

    def _find_spot(self) -> str:
        """The place at which the fingers are, or that of the lid on its plate; empty if there is none."""
        place = self._find_place_under(self.at)
        if not place:
            return ""
        unit = self.dialect.unit
        above = (self.at.z - self._spots[place].z) / unit
        if place in self._stacks:
            top = len(self.world.at(place)) * self.sizes.plate_mm
            # The fingers are around the topmost plate, or a plate in the hand stands on it.
            return place if -SPOT < above - (top - self.sizes.plate_mm) < 2 * self.sizes.plate_mm else ""
        if abs(above) < SPOT:
            return place
        if abs(above - self.sizes.lid_mm) < SPOT and (plate := self.top(place)):
            if self.world.is_shut(place):
                self.world.crash(self.name, place, "reaches into a closed gate")
            return lid_of(plate)
        return ""

    def damage(self, crash: Crash) -> None:
        """The arm stops its motion and reports the crash."""
        self.forget_plans()
        self.error = CRASHED
        self._finish(CRASHED)

    # -- replies -----------------------------------------------------------------------------

    def format_position(self, joints: Joints) -> str:
        """A position in the format of a reply to ``GETPOS``."""
        raise NotImplementedError

    def _send_data(self, text: str) -> None:
        self.send(text.encode() + END)

    def _send_result(self, code: int) -> None:
        self.send(f"{code:04d}".encode() + END)
