"""Drives a real PF400 through its TCP command server."""

from __future__ import annotations

import time
from math import dist, isfinite
from typing import Any, NamedTuple

from labos.errors import BadInput, Collision, DeviceError, Garbled, LinkError
from labos.link import Link, TcpWire, Terminated
from labos.node import Setup
from labos_drivers._simulation import place_of
from labos_drivers._wired import Behind, Wired, aside, host_and_port, off_loop
from labos_drivers.pf400 import kinematics, protocol
from labos_drivers.pf400.hand import Hand
from labos_drivers.pf400.kinematics import Joints
from labos_drivers.pf400.protocol import BETWEEN_GRIPS_MM, GRIPPER, NEUTRAL, RAIL, Grip

ANSWER_S, POWER_S, FINGERS_S, HOME_S, MOVE_S = 5.0, 30.0, 15.0, 60.0, 60.0
POLL_S, BEGIN_S = 0.05, 2.0
STILL, NEAR, FOLDED = 0.02, 0.5, 3.0
"""Between two looks, from a target, from the neutral pose; in mm and degrees alike."""
FORCE_N, FINGERS_PERCENT = 10, 100
APPROACH, TRAVEL = 1, 2
APPROACH_PERCENT, TRAVEL_PERCENT, SLOWER = 30.0, 60.0, 8.0
APPROACH_MM, LID_MM = 15.0, 7.0
INSIDE_MM = 60.0
"""So near a shelf's place, seen from above, the hand is inside."""
WHO = "a PreciseFlex 400"


class End(NamedTuple):
    """Where something is taken or put down: the place, the grip (or empty), the type of what stands there,
    the taught place through which the arm comes (or empty), and by how much higher than taught."""

    place: str
    grip: str
    kind: str
    approach: str = ""
    up_mm: float = 0.0


class Spot(NamedTuple):
    """A place as the arm goes there: its pose, the poses through which it comes and leaves, and from how far
    above it comes down."""

    name: str
    pose: Joints
    through: tuple[Joints, ...] = ()
    above_mm: float = APPROACH_MM

    def lifted(self, up_mm: float) -> Spot:
        return self._replace(pose=_lifted(self.pose, up_mm))

    @property
    def above(self) -> Joints:
        return _lifted(self.pose, self.above_mm)


class PF400Driver(Wired):
    """Commands of the device. Behind ``waitForEom`` it would hear no ``halt``: the end of a motion is
    seen by asking where the arm is."""

    deadlines = ("answer", "power", "fingers", "home", "move", "begin")
    where = ("host", "192.168.0.1")
    link: Link
    _is_free: bool | None = None
    """As the driver has told it; the controller tells nothing of free mode."""
    _too_wide_mm: float | None = None
    """The width of what was let go at the last try to take something."""
    _inside: Spot | None = None
    """The place into which the arm reaches by a way of its own."""

    def __init__(self, setup: Setup, address: str, simulator: Behind | None = None) -> None:
        super().__init__(setup, address, simulator)
        config = setup.config
        self._setup = setup
        self._hand = Hand(setup.name, config)
        self._lid_mm = float(config.get("lid_mm", LID_MM))
        self._above_mm = float(config.get("approach_mm", APPROACH_MM))
        self._above_mm_of = {
            place_of(setup, k): float(v) for k, v in config.get("approach_mm_of", {}).items()
        }
        self._through = {place_of(setup, k): _names(v) for k, v in config.get("approach", {}).items()}
        self._neutral: Joints = tuple(map(float, config.get("neutral", NEUTRAL)))
        if len(self._neutral) != len(NEUTRAL):
            raise BadInput(
                f"{setup.name}: `neutral` must be four joints: column, shoulder, elbow, wrist.",
                remedy=f"As shipped: {list(NEUTRAL)}.",
            )
        self._has_rail: bool | None = None
        self._speed = min(float(config.get("speed_percent", TRAVEL_PERCENT)), 100.0)
        self._limits = list(protocol.LIMITS)
        self.link = Link(
            TcpWire(*host_and_port(address, protocol.PORT)),
            Terminated(protocol.ANSWER_END, send_end=protocol.ASK_END),
            name=setup.name,
            identify=lambda _: self._recognise(),
            expected=WHO,
        )

    # -- plates ------------------------------------------------------------------------------

    @off_loop
    def carry(
        self,
        source: str,
        target: str,
        source_grip: str,
        target_grip: str,
        kind: str = "",
        *,
        slow: bool = False,
        through: tuple[str, str] = ("", ""),
        turn_at: str = "",
    ) -> None:
        """From place to place, through the regrip place if the grips differ (``turn_at``: through this one);
        ``kind`` is the type of labware. ``through`` are the taught places by which the arm comes to source
        and target."""
        ends = End(source, source_grip, kind, through[0]), End(target, target_grip, kind, through[1])
        self._transfer(*ends, slow, turn_at)

    @off_loop
    def pick(self, source: str, grip: str = "", kind: str = "", through: str = "") -> None:
        """Into the hand, and no further."""
        with self.motion():
            spot = self._spot(source, kind, through)
            self._check(spot)
            self._needs_empty_hand(self._ready())
            with self.under_way():
                held = self._pick(spot, self._grip(grip, spot.pose, kind))
            if not held:
                raise self._not_taken(source)

    @off_loop
    def unlid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        """The lid of the plate at a place, into a nest. ``kind`` is the lid's type, ``plate`` the plate's."""
        ends = End(source, source_grip, plate, up_mm=self._lid_mm), End(target, target_grip, kind)
        self._transfer(*ends)

    @off_loop
    def relid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        """A lid from its nest, onto the plate at a place."""
        ends = End(source, source_grip, kind), End(target, target_grip, plate, up_mm=self._lid_mm)
        self._transfer(*ends)

    @off_loop
    def put_down(self, target: str, kind: str = "", through: str = "") -> None:
        """What the fingers hold, in the grip that they have."""
        with self.motion():
            spot = self._spot(target, kind, through)
            self._check(spot)
            width = self._ready()[GRIPPER]
            fingers = self._hand.read(width)
            if fingers.state in ("open", "shut"):
                raise DeviceError(f"{self.name}: its hand is empty.", effects="none")
            # The lab knows that something is in the hand, also where its width alone does not tell.
            grip = fingers.grip or self._hand.likely_grip(width, kind)
            self._hand.grasp(grip, width)
            with self.under_way():
                self._place(spot, grip)

    @off_loop
    def open_fingers(self, wide: bool) -> None:
        """Open them in the air, where a person has seen that nothing is between them."""
        with self.motion():
            with self.at_rest():
                self._needs_power()
                self._attach()
                width = self._joints()[GRIPPER]
                if self._hand.read(width).state == "holding":
                    raise self._hand_is_full()
            with self.under_way():
                self._release(self._hand.grip("wide" if wide else "narrow", ""))

    @off_loop
    def explore(self) -> None:
        """Over every taught place, with an empty hand."""
        with self.motion():
            spots = [self._spot(name) for name in self._setup.poses]
            for kind, poses in self._setup.poses_of.items():
                spots += [self._spot(name, kind)._replace(name=f"{name} with a {kind}") for name in poses]
            for spot in spots:
                self._check(spot)
            self._needs_empty_hand(self._ready())
            with self.under_way():
                for spot in spots:
                    self._come(spot)
                    self._leave(spot)

    # -- by hand -----------------------------------------------------------------------------

    @off_loop
    def free(self, column: bool) -> None:
        """Its joints yield to a hand. They need not be homed, nor within their limits: so it is brought
        back there."""
        with self.motion():
            with self.at_rest():
                self._needs_power()
                self._attach()
                self._needs_empty_hand(self._joints())
            with self.under_way():
                self._is_free = True
                for axis in (*protocol.YIELDING, *([protocol.COLUMN] if column else [])):
                    self._ask(protocol.yields(axis))

    @off_loop
    def hold(self) -> None:
        """The end of that, then up and folded at a crawl."""
        with self.motion():
            with self.at_rest():
                self._needs_power()
                self._attach()
                self._ask(protocol.ALL_HOLD)
                self._is_free = False
                self._profiles(slow=True)
            with self.under_way():
                self._up_and_folded()

    @aside
    def pose(self) -> list[float]:
        return list(self._joints())

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """Power on, homed if it is not, then straight up and folded; what it holds it goes on holding."""
        self.resume()
        if self._number("hp") != protocol.ON:
            power_s = self.limit_s("power", POWER_S)
            self._ask(f"hp 1 {power_s:g}", power_s + self.limit_s("answer", ANSWER_S))
        self._attach()
        self._ask(protocol.ALL_HOLD)
        self._is_free = None
        with self.under_way():
            if self._number(f"pd {protocol.HOMED}") != protocol.ON:
                self._ask("home", self.limit_s("home", HOME_S))
            self._profiles(slow=True)
            self._up_and_folded()

    @aside
    def stop(self) -> None:
        """It halts where it is, with its power on, and goes on holding what it holds. While it homes or
        moves its fingers it does not hear this before it has done so."""
        self._halted.set()
        self._ask("halt", self.limit_s("home", HOME_S))

    @aside
    def is_idle(self) -> bool:
        before = self._joints()
        time.sleep(POLL_S)
        return _apart(before, self._joints()) < STILL

    @aside
    def look(self) -> dict[str, Any]:
        """The width of the fingers: as far apart as a plate is wide, they hold one; only open ones are
        empty. Nothing is said of any other width."""
        seen: dict[str, Any] = {} if self._is_free is None else {"free": self._is_free}
        state = self._hand.read(self._joints()[GRIPPER]).state
        if state in ("holding", "open"):
            seen["labware"] = {"gripper": state == "holding"}
        return seen

    # -- one transfer ------------------------------------------------------------------------

    def _transfer(self, source: End, target: End, slow: bool = False, turn_at: str = "") -> None:
        turn_at = turn_at or self._setup.regrip
        with self.motion():
            take, put = (
                self._spot(end.place, end.kind, end.approach).lifted(end.up_mm) for end in (source, target)
            )
            carried = target.kind if source.up_mm else source.kind
            grips = self._grip(source.grip, take.pose, carried), self._grip(target.grip, put.pose, carried)
            turn = self._turn(*grips, carried, turn_at) if source.grip and target.grip else ()
            for spot in (take, put, *turn):
                self._check(spot)
            self._needs_empty_hand(self._ready(slow))
            with self.under_way():
                held = self._pick(take, grips[0])
                if held and turn:
                    self._place(turn[0], grips[0])
                    held = self._pick(turn[1], grips[1])
                    if not held:
                        raise DeviceError(f"{self.name}: the plate is lost at {turn_at}.")
                if held:
                    self._place(put, grips[1] if turn else grips[0])
            if not held:
                raise self._not_taken(source.place)

    def _turn(self, before: Grip, after: Grip, kind: str, place: str) -> tuple[Spot, ...]:
        """How the plate is put down and how it is picked up at the regrip place; nothing if the grip
        does not change. The place was taught for the narrow grip."""
        if before.name == after.name:
            return ()
        if not place:
            raise DeviceError(
                f"{self.name}: it has no place where it could change from {before.name} to {after.name}.",
                effects="none",
                remedy="Write `regrip:` for the module in the workcell file, or `rotation_deck:` for a step.",
            )
        narrow = self._spot(place, kind)
        pose = kinematics.turned(narrow.pose, 90.0, self._limits)
        if pose is None:
            raise DeviceError(
                f"{self.name}: it cannot turn its hand at {place}.",
                effects="none",
                remedy="Teach this place nearer to the rail, or another one.",
            )
        wide = narrow._replace(pose=pose)
        return (narrow, wide) if before.name == "narrow" else (wide, narrow)

    def _pick(self, spot: Spot, grip: Grip) -> bool:
        """True if something is between the fingers, which have come back with it. What is so wide that it
        could not be told from open fingers later is let go where it stood."""
        self._release(grip)
        self._come(spot)
        self._go(spot.pose, APPROACH)
        answer = self._ask(
            f"GraspPlate {grip.closed_mm:g} {FINGERS_PERCENT} {FORCE_N}", self.limit_s("fingers", FINGERS_S)
        )
        width = self._joints()[GRIPPER]
        self._too_wide_mm = width if answer == "-1" and self._hand.looks_open(width) else None
        held = answer == "-1" and self._too_wide_mm is None
        if held:
            self._hand.grasp(grip, width)
        else:
            self._release(grip)
        self._leave(spot)
        return held

    def _not_taken(self, place: str) -> DeviceError:
        """The arm has come back without a plate."""
        if self._too_wide_mm is not None:
            return DeviceError(
                f"{self.name}: what stands at {place} is {self._too_wide_mm:.1f} mm wide between the "
                "fingers, as if they were open; it was let go where it stood.",
                effects="none",
                remedy="Say how wide it is gripped: `grips_of:` in the module's config.",
            )
        return DeviceError(
            f"{self.name}: nothing came between the fingers at {place}.",
            effects="none",
            remedy="Look whether a plate is there, and where it was taught.",
        )

    def _place(self, spot: Spot, grip: Grip) -> None:
        self._come(spot)
        self._go(spot.pose, APPROACH)
        if self._hand.read(self._joints()[GRIPPER]).state != "holding":
            raise DeviceError(
                f"{self.name}: what it held it has lost on its way.",
                remedy="Look where the plate is, then reset the module.",
            )
        self._release(grip)
        self._leave(spot)

    def _come(self, spot: Spot) -> None:
        """Over a place, by the way that leads there."""
        self._fold((spot.through or (spot.pose,))[0][RAIL])
        self._inside = spot if spot.through else None
        for pose in spot.through:
            self._go(pose, TRAVEL)
        self._go(spot.above, APPROACH if spot.through else TRAVEL)

    def _leave(self, spot: Spot) -> None:
        """Up, back by the same way, and folded."""
        self._go(spot.above, APPROACH)
        for pose in reversed(spot.through):
            self._go(pose, APPROACH)
        self._inside = None
        self._fold((spot.through or (spot.pose,))[0][RAIL])

    def _fold(self, rail: float) -> None:
        """The arm close to the column, and then along the rail."""
        here = self._joints()
        if not self._is_folded(here):
            self._go((*self._neutral, 0.0, here[RAIL]), TRAVEL)
        self._go((*self._neutral, 0.0, rail), TRAVEL)

    def _release(self, grip: Grip) -> None:
        self.unless_stopped()
        self._hand.forget()
        self._ask(f"ReleasePlate {grip.open_mm:g} {FINGERS_PERCENT}", self.limit_s("fingers", FINGERS_S))

    # -- one motion --------------------------------------------------------------------------

    def _go(self, pose: Joints, profile: int) -> None:
        """Go there, and wait until the arm has come to rest; the fingers stay as they are."""
        self.unless_stopped()
        fingers = self._joints()[GRIPPER]
        joints = (*pose[:GRIPPER], fingers, *pose[RAIL:])
        told = joints if self._rail() else joints[:RAIL]
        self._ask(f"movej {profile} " + " ".join(f"{value:.3f}" for value in told))
        began = time.monotonic()
        before = self._joints()
        while True:
            if self._halted.is_set():
                # The motion may have been sent just after the halt.
                self._ask("halt")
                self.unless_stopped()
            time.sleep(POLL_S)
            here = self._joints()
            at_rest, before = _apart(here, before) < STILL, here
            passed_s = time.monotonic() - began
            if at_rest and _apart(here, joints) < NEAR:
                return
            # Just after the command it may not have begun to move.
            if (at_rest and passed_s > self.limit_s("begin", BEGIN_S)) or passed_s > self.limit_s(
                "move", MOVE_S
            ):
                raise self._stopped_short(joints, here)

    def _stopped_short(self, wanted: Joints, here: Joints) -> DeviceError:
        axis = max((n for n in range(6) if n != GRIPPER), key=lambda n: abs(wanted[n] - here[n]))
        state = self._number("sysState")
        why = "the emergency stop is pressed" if state == protocol.HARD_STOP else f"system state {state}"
        return DeviceError(
            f"{self.name}: the arm stopped short: {protocol.AXES[axis]} at {here[axis]:.1f}, not at "
            f"{wanted[axis]:.1f} ({why}).",
            remedy=protocol.COLLIDED,
        )

    def _ready(self, slow: bool = False) -> Joints:
        """Where the arm is. Raises DeviceError, before anything moves, if it may not move from there."""
        with self.at_rest():
            self._needs_power()
            if self._is_free:
                raise DeviceError(
                    f"{self.name}: somebody guides it by hand.", remedy="Step back, then end_free_mode."
                )
            if self._number(f"pd {protocol.HOMED}") != protocol.ON:
                raise DeviceError(f"{self.name}: it is not homed.", remedy="Reset the module.")
            self._attach()
            here = self._joints()
            if not self._is_folded(here):
                raise DeviceError(
                    f"{self.name}: the arm is not folded, so that its way is not known to be free.",
                    remedy="See that nothing is above it, then reset the module.",
                )
            self._profiles(slow)
        return here

    def _up_and_folded(self) -> None:
        here = self._joints()
        if self._is_folded(here):
            return
        inside = self._reaching_into(here)
        if inside is not None:
            self._leave(inside)
            return
        self._go(_lifted(here, self._neutral[0] - here[0]), TRAVEL)
        self._fold(here[RAIL])

    def _reaching_into(self, here: Joints) -> Spot | None:
        """The place with a way of its own, such as a shelf, near which the hand is: straight up, it would
        hit what is above."""
        taught = {place_of(self._setup, name) for name in self._setup.poses}
        spots = [self._spot(name) for name in self._through if name in taught]
        spots += [self._inside] if self._inside is not None else []
        at = kinematics.hand(here)[:2]
        near = [(dist(at, kinematics.hand(spot.pose)[:2]), spot) for spot in spots]
        near = [(away, spot) for away, spot in near if away <= INSIDE_MM]
        if not near:
            return None
        spot = min(near, key=lambda pair: (abs(here[0] - pair[1].pose[0]), pair[0]))[1]
        up_mm = max(here[0] - spot.pose[0], 0.0)
        return spot._replace(above_mm=min(up_mm, spot.above_mm))

    def _is_folded(self, joints: Joints) -> bool:
        return all(abs(a - b) < FOLDED for a, b in zip(joints[1:4], self._neutral[1:], strict=True))

    def _needs_power(self) -> None:
        if self._number("hp") != protocol.ON:
            raise DeviceError(f"{self.name}: its power is off.", remedy="Reset the module.")

    def _attach(self) -> None:
        if self._number("attach") == 0:
            self._ask("attach 1")

    def _profiles(self, slow: bool = False) -> None:
        for profile, percent in ((APPROACH, APPROACH_PERCENT), (TRAVEL, self._speed)):
            speed = min(percent, self._speed) / (SLOWER if slow else 1.0)
            self._ask(f"Profile {profile} {speed:.1f} 0 {speed:.1f} {speed:.1f} 0.1 0.1 10 0")

    def _needs_empty_hand(self, here: Joints) -> None:
        state = self._hand.read(here[GRIPPER]).state
        if state == "holding":
            raise self._hand_is_full()
        if state != "open":
            raise DeviceError(
                f"{self.name}: it cannot be told whether its hand is empty: the fingers are "
                f"{here[GRIPPER]:.1f} mm apart; open they are {self._hand.widths()}.",
                effects="none",
                remedy="Look. If it holds something: put_down. If it does not: open_fingers. A plate of this "
                "width is described by `grips_of:` in the module's config.",
            )

    def _hand_is_full(self) -> DeviceError:
        return DeviceError(
            f"{self.name}: its hand is full.", effects="none", remedy="Put down what it holds: put_down."
        )

    def _grip(self, wanted: str, pose: Joints, kind: str) -> Grip:
        """As told, else as the place was taught."""
        side = wanted or ("wide" if pose[GRIPPER] > BETWEEN_GRIPS_MM else "narrow")
        return self._hand.grip(side, kind)

    # -- places ------------------------------------------------------------------------------

    def _spot(self, place: str, kind: str = "", through: str = "") -> Spot:
        """Raises DeviceError for a place, or a way to it, that was not taught."""
        here = place_of(self._setup, place)
        ways = _names(through) if through else self._through.get(here, ())
        above_mm = self._above_mm_of.get(here, self._above_mm)
        return Spot(place, self._pose(place, kind), tuple(self._pose(name, kind) for name in ways), above_mm)

    def _pose(self, place: str, kind: str = "") -> Joints:
        """As it was taught for a type of labware, else for any. Raises DeviceError."""
        poses = {place_of(self._setup, name): pose for name, pose in self._setup.poses_for(kind).items()}
        pose = poses.get(place_of(self._setup, place))
        joints = len(protocol.AXES) if self._rail() else RAIL
        if pose is None or not joints <= len(pose) <= len(protocol.AXES):
            wrong = "was not taught" if pose is None else f"was taught with {len(pose)} joints, not {joints}"
            raise DeviceError(
                f"{self.name}: the place {place} {wrong}.",
                effects="none",
                remedy="Teach it: `locations:` of the workcell file.",
            )
        return tuple(pose) if self._rail() else (*pose[:RAIL], 0.0)

    def _rail(self) -> bool:
        """Whether the arm stands on a rail: it tells six joints then, else five."""
        if self._has_rail is None:
            self._joints()
        return bool(self._has_rail)

    def _check(self, spot: Spot) -> None:
        """Raise DeviceError, before anything moves, for a place that the arm cannot reach."""
        for pose in (spot.pose, spot.above, *spot.through):
            for axis, (low, high) in enumerate(self._limits):
                value = pose[axis]
                if not low <= value <= high and axis != GRIPPER:
                    raise DeviceError(
                        f"{self.name}: {spot.name} is out of reach: {protocol.AXES[axis]} at {value:g}, "
                        f"limits {low:g} to {high:g}.",
                        effects="none",
                        remedy="Teach the place again.",
                    )

    # -- one question ------------------------------------------------------------------------

    def _ask(self, question: str, timeout_s: float = 0.0) -> str:
        """The data of the answer. Raises DeviceError for a negative code."""
        answer_s = timeout_s or self.limit_s("answer", ANSWER_S)
        answer = self.link.exchange(question.encode(), answer_s).decode("ascii", "replace")
        code, _, data = answer.partition(" ")
        try:
            number = int(code)
        except ValueError as error:
            raise Garbled(f"{self.name}: {answer!r} is no answer to {question!r}.") from error
        if number >= 0:
            return data.strip()
        fault = protocol.FAULTS.get(number, protocol.Fault(data.strip() or "an error", effects="unknown"))
        kind = Collision if fault.remedy == protocol.COLLIDED else DeviceError
        raise kind(
            f"{self.name}: PreciseFlex error {number}: {fault.meaning} (to {question!r}).",
            effects=fault.effects,
            remedy=fault.remedy,
        )

    def _number(self, question: str) -> int:
        data = self._ask(question)
        try:
            return int(float(data))
        except (ValueError, OverflowError) as error:
            raise Garbled(f"{self.name}: {data!r} is no number, the answer to {question!r}.") from error

    def _joints(self) -> Joints:
        data = self._ask("wherej")
        try:
            joints = tuple(float(value) for value in data.split())
        except ValueError as error:
            raise Garbled(f"{self.name}: {data!r} does not say where the arm is.") from error
        if not all(map(isfinite, joints)):
            raise Garbled(f"{self.name}: {data!r} does not say where the arm is.")
        if not RAIL <= len(joints) <= len(protocol.AXES):
            raise Garbled(
                f"{self.name}: {data!r} has {len(joints)} joints; an arm has five, or six with a rail."
            )
        self._has_rail = len(joints) > RAIL
        return joints if self._has_rail else (*joints, 0.0)

    def _recognise(self) -> str:
        self._ask("mode 0")
        self._ask("selectRobot 1")
        kind = self._number(f"pd {protocol.ROBOT_TYPE}")
        self._limits = self._soft_limits()
        if kind != protocol.PF400:
            return f"a robot of type {kind}"
        self.see_unit(self._told(f"pd {protocol.SERIAL_NUMBER}"))
        self.note_firmware(self._told("version"))
        return WHO

    def _told(self, command: str) -> str:
        """What the controller answers; empty if it does not know the command."""
        try:
            return self._ask(command).strip('" ')
        except LinkError:
            raise
        except DeviceError:
            return ""

    def _soft_limits(self) -> list[tuple[float, float]]:
        """The arm's own where they are narrower. Columns and rails differ: theirs are as the arm tells."""
        ends = []
        for parameter in (protocol.SOFT_MINIMA, protocol.SOFT_MAXIMA):
            data = self._ask(f"pd {parameter}")
            try:
                ends.append([float(value) for value in data.replace(",", " ").split()])
            except ValueError as error:
                raise Garbled(f"{self.name}: {data!r} does not tell its limits.") from error
        limits = list(protocol.LIMITS)
        for axis, (low, high) in enumerate(zip(*ends, strict=False)):
            if low < high and axis < len(limits):
                known = protocol.LONGEST.get(axis, limits[axis])
                limits[axis] = max(low, known[0]), min(high, known[1])
        return limits


def _lifted(pose: Joints, up_mm: float) -> Joints:
    return (pose[0] + up_mm, *pose[1:])


def _apart(one: Joints, other: Joints) -> float:
    """The largest difference of any axis but the fingers, which yield to what they hold."""
    pairs = zip(one, other, strict=True)
    return max(abs(a - b) for axis, (a, b) in enumerate(pairs) if axis != GRIPPER)


def _names(told: Any) -> tuple[str, ...]:
    """One name, or several."""
    return (told,) if isinstance(told, str) else tuple(map(str, told))
