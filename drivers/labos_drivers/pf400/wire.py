"""A simulated PF400 at the far end of a TCP connection: a command server, and an arm. In a motion, all joints
move at constant speeds and arrive together.

It has the taught poses of its setup. The world decides what is between its fingers there. Later commands wait
after ``waitForEom``, ``pickplate`` and ``placeplate``, during homing and power-on, and while fingers move.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from math import dist

from labos.link import FarEnd, TcpEnd
from labos.node import Crash, Setup
from labos.node.world import lid_of
from labos_drivers._onwire import OnLine
from labos_drivers._simulation import place_of
from labos_drivers.pf400 import kinematics, protocol
from labos_drivers.pf400.kinematics import Joints

SPEEDS = (250.0, 180.0, 180.0, 360.0, 100.0, 750.0)
"""Of each axis at 100 %, in mm or degrees a second."""
LID_MM, SPOT_MM = 7.0, 3.0
POWER_S, HOME_S, FINGERS_S = 3.0, 15.0, 1.0
SQUEEZE_MM = 12.0
"""So much further the fingers go if nothing is between them."""
COLLISION = -3100


class PF400OnWire(OnLine):
    """The simulated arm. ``started``: it is powered, attached and homed at first. ``is_slippery``: what it
    holds falls down during a motion. ``wider_mm``: what it grips is wider by this than the closed width.
    ``has_rail``: an arm without a rail reports five joints."""

    serial = "PF04-20000"

    def __init__(
        self,
        setup: Setup,
        end: FarEnd | None = None,
        *,
        started: bool = True,
        has_rail: bool = True,
        limits: tuple[tuple[float, float], ...] = protocol.LIMITS,
    ) -> None:
        super().__init__(setup, end)
        self.limits = limits
        self._axes = len(protocol.AXES) if has_rail else protocol.RAIL
        self.powered = self.attached = self.homed = started
        self.stop_is_pressed = False
        self.is_slippery = False
        self.wider_mm = 0.0
        # After a power loss, the hand still holds what it held before.
        grip = protocol.NARROW
        fingers = grip.closed_mm if self.find_held_plate() else grip.open_mm
        self.joints: Joints = (*protocol.NEUTRAL, fingers, 0.0)
        self._path: tuple[Joints, Joints, float, float] | None = None
        self._motion = 0
        self._then: Callable[[], None] | None = None
        self._lines: deque[str] = deque()
        self._deaf = False
        self.free_axes: set[int] = set()
        self._grips = {"open": protocol.NARROW.open_mm, "closed": protocol.NARROW.closed_mm}
        self._profiles: dict[int, list[str]] = {}
        self._taught: dict[int, Joints] = {}
        self._clearance: dict[int, float] = {}
        self._lid_mm = float(setup.config.get("lid_mm", LID_MM))
        self._spots: dict[str, dict[str, tuple[float, ...]]] = {}
        for kind, poses in {"": setup.poses, **setup.poses_of}.items():
            for name, pose in poses.items():
                if len(pose) >= self._axes:
                    spots = self._spots.setdefault(place_of(setup, name), {})
                    spots[kind] = kinematics.find_hand((*pose, 0.0)[: len(protocol.AXES)])

    def make_end(self) -> FarEnd:
        return TcpEnd()

    @property
    def is_in_motion(self) -> bool:
        return self._path is not None

    def set_fingers(self, width_mm: float) -> None:
        """Set the width of the fingers (mm). Tests call it for a person who moves them by hand."""
        self.joints = (*self.joints[:4], width_mm, *self.joints[5:])

    # -- receiving ---------------------------------------------------------------------------

    def obey(self, line: str) -> None:
        self._lines.append(line)
        self._obey_all()

    def _obey_all(self) -> None:
        while self._lines and not self._deaf:
            line = self._lines.popleft()
            if line:
                self._obey(line)

    def _obey(self, line: str) -> None:
        name, *words = line.split()
        name = name.lower()
        if name in ("movej", "moveoneaxis", "move", "moveappro", "pickplate", "placeplate") and self._path:
            # A second motion waits for the end of the first, and all commands after it wait too.
            self._lines.appendleft(line)
            self._deaf = True
            return
        orders: dict[str, Callable[[list[str]], None]] = {
            "nop": lambda w: self._send_done(),
            "mode": lambda w: self._send_done() if w else self._send_done("0"),
            "selectrobot": lambda w: self._send_done() if w else self._send_done("1"),
            "version": lambda w: self._send_done("TCS 3.0D4"),
            "sysstate": lambda w: self._send_done(str(self._make_system_state())),
            "state": lambda w: self._send_done("2.0" if self._path else "1.0"),
            "hp": self._power,
            "attach": self._attach,
            "home": lambda w: self._home(),
            "halt": lambda w: self._halt(),
            "freemode": self._free_mode,
            "exit": lambda w: None,
            "pd": self._parameter,
            "wherej": lambda w: self._send_done(
                " ".join(f"{value:.3f}" for value in self._compute_joints()[: self._axes])
            ),
            "wherec": lambda w: self._send_done(
                "{:.3f} {:.3f} {:.3f} {:.3f} 90 180 1".format(*kinematics.find_hand(self._compute_joints()))
            ),
            "waitforeom": lambda w: self._wait_for_end(),
            "profile": self._profile,
            "speed": self._speed,
            "movej": lambda w: self._begin(self._parse_joints(w[1:]), int(w[0])),
            "moveoneaxis": self._move_one,
            "move": lambda w: self._begin(self._taught[int(w[0])], int(w[1])),
            "moveappro": lambda w: self._begin(self._find_approach(int(w[0])), int(w[1])),
            "locangles": self._teach,
            "stationtype": self._station,
            "gripopenpos": lambda w: self._grip_width("open", w),
            "gripclosepos": lambda w: self._grip_width("closed", w),
            "gripper": self._gripper,
            "graspdata": lambda w: self._grip_width("closed", w),
            "graspplate": lambda w: self._close_fingers(float(w[0]), lambda held: str(-held)),
            "releaseplate": lambda w: self._open_fingers(float(w[0])),
            "isfullyclosed": lambda w: self._send_done(str(-(self.joints[4] <= protocol.FULLY_CLOSED_MM))),
            "pickplate": self._pick_plate,
            "placeplate": self._place_plate,
        }
        if name not in orders:
            self._refuse(-2805)
            return
        try:
            orders[name](words)
        except (IndexError, KeyError, ValueError):
            self._refuse(-2802)

    # -- power, homing, parameters -----------------------------------------------------------

    def _make_system_state(self) -> int:
        if self.stop_is_pressed:
            return protocol.HARD_STOP
        return 7 if not self.powered else 21 if self.attached else 20

    def _power(self, words: list[str]) -> None:
        if not words:
            self._send_done(str(int(self.powered)))
        elif words[0] == "0":
            self.powered = self.attached = False
            self.free_axes.clear()
            self._send_done()
        elif self.stop_is_pressed:
            self._refuse(-1028)
        elif self.powered:
            self._send_done()
        else:

            def switch_on() -> None:
                self.powered = True
                self._send_done()

            self._finish_after(POWER_S, switch_on)

    def _attach(self, words: list[str]) -> None:
        if not words:
            self._send_done("-1" if self.attached else "0")
        elif words[0] == "1" and not self.powered:
            self._refuse(-1046)
        else:
            self.attached = words[0] == "1"
            self._send_done()

    def _home(self) -> None:
        if not (self.powered and self.attached):
            self._refuse(-1046 if not self.powered else -1009)
            return

        def finish_homing() -> None:
            self.homed = True
            self._send_done()

        self.world.enter(self.name, self.name)
        self._finish_after(HOME_S, finish_homing)

    def _parameter(self, words: list[str]) -> None:
        limits = list(zip(*self.limits, strict=True))
        parameters = {
            protocol.ROBOT_TYPE: str(protocol.PF400),
            protocol.SERIAL_NUMBER: f'"{self.serial}"',
            protocol.HOMED: str(int(self.homed)),
            protocol.SOFT_MINIMA: ", ".join(map(str, limits[0])),
            protocol.SOFT_MAXIMA: ", ".join(map(str, limits[1])),
        }
        self._send_done(parameters[int(words[0])])

    def _profile(self, words: list[str]) -> None:
        if len(words) == 9:
            self._profiles[int(words[0])] = words[1:]
            self._send_done()
        else:
            self._send_done(" ".join((words[0], *self._profiles.get(int(words[0]), ["50"] * 8))))

    def _speed(self, words: list[str]) -> None:
        profile = self._profiles.setdefault(int(words[0]), ["50"] * 8)
        if len(words) == 1:
            self._send_done(f"{words[0]} {profile[0]}")
        else:
            profile[0] = words[1]
            self._send_done()

    def _teach(self, words: list[str]) -> None:
        if len(words) == 1:
            self._send_done(" ".join(("1", words[0], *(f"{v:.3f}" for v in self._taught[int(words[0])]))))
        else:
            self._taught[int(words[0])] = self._parse_joints(words[1:])
            self._send_done()

    def _station(self, words: list[str]) -> None:
        self._clearance[int(words[0])] = float(words[3])
        self._send_done()

    # -- by hand -----------------------------------------------------------------------------

    def _free_mode(self, words: list[str]) -> None:
        axis = int(words[0])
        if not (self.powered and self.attached):
            self._refuse(-1046 if not self.powered else -1009)
        elif axis > len(protocol.AXES) or axis < -1:
            self._refuse(-2802)
        else:
            before = bool(self.free_axes)
            self.free_axes = (
                set() if axis < 0 else set(range(6)) if axis == 0 else {*self.free_axes, axis - 1}
            )
            if before is not bool(self.free_axes):
                self.world.work(self.name, "hold" if before else "yield")
            self._send_done()

    def guide(self, joints: Joints) -> None:
        """A person pushes the arm: only the joints in free mode move."""
        here = enumerate(zip(self.joints, joints, strict=True))
        self.joints = tuple(new if axis in self.free_axes else old for axis, (old, new) in here)

    # -- moving ------------------------------------------------------------------------------

    def _parse_joints(self, words: list[str]) -> Joints:
        """The joints in the words of a command. Joints that are left out keep their positions."""
        given = tuple(float(word) for word in words)
        if not 4 <= len(given) <= self._axes:
            raise ValueError("joints are missing")
        return given + self._compute_joints()[len(given) :]

    def _find_approach(self, station: int) -> Joints:
        taught = self._taught[station]
        return (taught[0] + self._clearance.get(station, 0.0), *taught[1:])

    def _begin(self, target: Joints, profile: int) -> None:
        """Start a motion. The reply is sent when the motion is accepted, long before its end."""
        if self._may_move(target):
            self._move(target, profile)
            self._send_done()

    def _may_move(self, target: Joints) -> bool:
        if self.free_axes:
            self.world.crash(self.name, self.name, "moves while a person guides it")
        out = any(not low <= value <= high for value, (low, high) in zip(target, self.limits, strict=True))
        for wrong, code in (
            (not self.powered, -1046),
            (not self.attached, -1009),
            (not self.homed, -1021),
            (out, -1012),
        ):
            if wrong:
                self._refuse(code)
                return False
        return True

    def _move(self, target: Joints, profile: int = 1, then: Callable[[], None] | None = None) -> None:
        start = self._compute_joints()
        percent = float(self._profiles.get(profile, ["50"])[0])
        took_s = max(abs(b - a) / s for a, b, s in zip(start, target, SPEEDS, strict=True)) * 100 / percent
        took_s = self.scatter(took_s + 0.3)
        self.world.enter(self.name, self.name)
        if place := self._find_place_under(target):
            self.world.enter(self.name, place)
        self._path = start, target, self.now_s(), took_s
        self._motion += 1
        motion, self._then = self._motion, then
        self.after(took_s, lambda: self._arrive(motion), exact=True)

    def _arrive(self, motion: int) -> None:
        if motion != self._motion or self._path is None:
            return
        self.joints, self._path = self._path[1], None
        if self.is_slippery and self.world.drop(self.name):
            self.set_fingers(max(self.joints[4] - SQUEEZE_MM, protocol.LIMITS[protocol.GRIPPER][0]))
        if not self._find_place_under(self.joints):
            self.world.leave(self.name)
        then, self._then = self._then, None
        if then is not None:
            then()
        else:
            self._listen_again()

    def _compute_joints(self) -> Joints:
        if self._path is None:
            return self.joints
        start, target, began_s, took_s = self._path
        part = min((self.now_s() - began_s) / took_s, 1.0)
        return tuple(a + part * (b - a) for a, b in zip(start, target, strict=True))

    def _halt(self) -> None:
        self._freeze()
        self._send_done()

    def _freeze(self) -> None:
        self.joints, self._path, self._then = self._compute_joints(), None, None

    def _wait_for_end(self) -> None:
        if self._path is None:
            self._send_done()
            return
        self._deaf = True
        self._then = lambda: self._listen_again("")

    def _move_one(self, words: list[str]) -> None:
        target = list(self._compute_joints())
        target[int(words[0]) - 1] = float(words[1])
        self._begin(tuple(target), int(words[2]))

    # -- fingers -----------------------------------------------------------------------------

    def _grip_width(self, which: str, words: list[str]) -> None:
        if words:
            self._grips[which] = float(words[0])
            self._send_done()
        else:
            self._send_done(f"{self._grips[which]:.3f}")

    def _gripper(self, words: list[str]) -> None:
        if words[0] == "1":
            self._open_fingers(self._grips["open"])
        else:
            self._close_fingers(self._grips["closed"], lambda held: "")

    def _close_fingers(self, width: float, report: Callable[[bool], str]) -> None:
        self._finish_after(FINGERS_S, lambda: self._send_done(report(self._grasp(width))))

    def _open_fingers(self, width: float) -> None:
        def open_hand() -> None:
            self._release_plate(width)
            self._send_done()

        self._finish_after(FINGERS_S, open_hand)

    def _grasp(self, width: float) -> bool:
        """Close the fingers. Returns whether something is between them."""
        if self.find_held_plate():
            held = True
        else:
            place = self._find_spot()
            held = bool(place and self.world.at(place))
            if held:
                self.world.grip(self.name, place, _name_grip(width))
        self.set_fingers(width + self.wider_mm if held else max(width - SQUEEZE_MM, 60.0))
        return held

    def _release_plate(self, width: float) -> None:
        if self.find_held_plate() and width > self.joints[4]:
            place = self._find_spot()
            if not place:
                self.world.crash(self.name, self.name, "drops a plate")
            self.open_hand(place, _name_grip(width))
        self.set_fingers(width)

    def _find_place_under(self, joints: Joints) -> str:
        """The place below the hand; empty if there is none."""
        x, y, *_ = kinematics.find_hand(joints)
        return next(self._find_places_near((x, y), 10 * SPOT_MM), "")

    def _find_places_near(self, at: tuple[float, float], most_mm: float) -> Iterator[str]:
        """The places within ``most_mm`` of a point, seen from above."""
        for place, spots in self._spots.items():
            if any(dist(at, spot[:2]) < most_mm for spot in spots.values()):
                yield place

    def _find_spot(self) -> str:
        """The place where the fingers are, or the place of the lid on the plate there; empty if they are at
        neither. Their grip point there depends on what they hold, else on what stands there."""
        x, y, z, _ = kinematics.find_hand(self.joints)
        held = self.find_held_plate()
        for place in self._find_places_near((x, y), SPOT_MM):
            plate = self.top(place)
            if self._is_at((x, y, z), self._find_grip_point(place, held or plate)):
                return place
            if plate and self._is_at((x, y, z - self._lid_mm), self._find_grip_point(place, plate)):
                if self.world.is_shut(place):
                    self.world.crash(self.name, place, "reaches into a closed gate")
                return lid_of(plate)
        return ""

    def _find_grip_point(self, place: str, plate: str) -> tuple[float, ...] | None:
        """The position at which the fingers grip this type of plate at a place; None if it is unknown."""
        spots = self._spots[place]
        return spots.get(self.world.kind(plate)) or spots.get("")

    @staticmethod
    def _is_at(fingers: tuple[float, float, float], spot: tuple[float, ...] | None) -> bool:
        x, y, z = fingers
        return spot is not None and dist((x, y), spot[:2]) <= SPOT_MM and abs(z - spot[2]) < SPOT_MM

    # -- picking and placing by the firmware ---------------------------------------------------

    def _pick_plate(self, words: list[str]) -> None:
        self._visit(int(words[0]), lambda: str(-self._grasp(self._grips["closed"])))

    def _place_plate(self, words: list[str]) -> None:
        def work() -> str:
            self._release_plate(self._grips["open"])
            return ""

        self._visit(int(words[0]), work)

    def _visit(self, station: int, work: Callable[[], str]) -> None:
        """Move down to a station, do the work, and move up. The reply is sent at the end."""
        if not self._may_move(self._taught[station]):
            return
        self._deaf = True

        def arrive() -> None:
            report = work()
            up = (*self._find_approach(station)[:4], *self.joints[4:])
            self._move(up, then=lambda: self._listen_again(report))

        target = self._taught[station]
        self._move((*target[:4], self.joints[4], *target[5:]), then=arrive)

    # -- faults ------------------------------------------------------------------------------

    def press_stop(self) -> None:
        """A person presses the emergency stop."""
        self.after(0, self._cut_power, exact=True)

    def _cut_power(self) -> None:
        self.stop_is_pressed, self.powered, self.attached = True, False, False
        self.free_axes.clear()
        self._freeze()
        if self._deaf:
            self.forget_plans()
            self._deaf = False
            self._refuse(-1028)

    def damage(self, crash: Crash) -> None:
        self.powered = self.attached = False
        self._freeze()
        self._deaf = False
        self._refuse(COLLISION)

    # -- replies -----------------------------------------------------------------------------

    def _finish_after(self, lab_s: float, what: Callable[[], None]) -> None:
        """Do something after a number of lab seconds. Commands that come before then wait."""
        self._deaf = True

        def end() -> None:
            what()
            self._listen_again()

        self.after(lab_s, end)

    def _listen_again(self, report: str | None = None) -> None:
        """Send the report, if there is one. Then execute the commands that have waited."""
        self._deaf = False
        if report is not None:
            self._send_done(report)
        self._obey_all()

    def _send_done(self, data: str = "") -> None:
        self.send((f"0 {data}" if data else "0").encode() + protocol.ANSWER_END)

    def _refuse(self, code: int) -> None:
        fault = protocol.FAULTS.get(code)
        text = fault.meaning if fault else "refused"
        self.send(f"{code} *{text}*".encode() + protocol.ANSWER_END)


def _name_grip(width: float) -> str:
    return "wide" if width > protocol.BETWEEN_GRIPS_MM else "narrow"
