"""The driver of the PF400, through the TCP command server of its controller."""

from __future__ import annotations

import time
from math import dist, isfinite
from typing import Any, NamedTuple

from labos.errors import BadInput, Collision, DeviceError, Garbled, LinkError
from labos.link import Link, TcpWire, Terminated
from labos.node import Setup
from labos_drivers._simulation import place_of
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop, parse_host_port
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
    """One end of a transfer: its place, the grip (empty: as taught), and the labware type whose taught pose
    is used. ``approach`` is the taught place through which the arm comes (empty: as configured). ``up_mm`` is
    the height above the taught pose."""

    place: str
    grip: str
    kind: str
    approach: str = ""
    up_mm: float = 0.0


class Spot(NamedTuple):
    """The poses for a place. The arm comes and leaves through the poses ``through``. It comes down to the
    pose of the place from ``above_mm`` above it."""

    name: str
    pose: Joints
    through: tuple[Joints, ...] = ()
    above_mm: float = APPROACH_MM

    def raise_by(self, up_mm: float) -> Spot:
        return self._replace(pose=_raise_pose(self.pose, up_mm))

    @property
    def above(self) -> Joints:
        return _raise_pose(self.pose, self.above_mm)


class PF400Driver(Wired):
    """The driver never sends ``waitForEom``: the controller would then ignore ``halt`` until the motion ends.
    To detect the end of a motion, the driver reads the arm's position."""

    deadlines = ("answer", "power", "fingers", "home", "move", "begin")
    where = ("host", "192.168.0.1")
    link: Link
    _is_free: bool | None = None
    """As the driver has told it; the controller tells nothing of free mode."""
    _too_wide_mm: float | None = None
    """The width of what was let go at the last try to take something."""
    _inside: Spot | None = None
    """The place into which the arm reaches by a way of its own."""

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        config = setup.config
        self._hand = Hand(setup.name, config)
        self._lid_mm = float(config.get("lid_mm", LID_MM))
        self._above_mm = float(config.get("approach_mm", APPROACH_MM))
        self._above_mm_of = {
            place_of(setup, k): float(v) for k, v in config.get("approach_mm_of", {}).items()
        }
        self._through = {place_of(setup, k): _list_names(v) for k, v in config.get("approach", {}).items()}
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
            TcpWire(*parse_host_port(address, protocol.PORT)),
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
        """Carry labware of the type ``kind`` from one place to another. If both grips are given and differ,
        the grip is changed at the regrip place (at ``turn_at``, if it is given). ``through`` has the taught
        places through which the arm comes to source and target."""
        ends = End(source, source_grip, kind, through[0]), End(target, target_grip, kind, through[1])
        self._transfer(*ends, slow, turn_at)

    @off_loop
    def pick(self, source: str, grip: str = "", kind: str = "", through: str = "") -> None:
        """Take a plate into the hand, and keep it there."""
        with self.motion():
            spot = self._find_spot(source, kind, through)
            self._check_reach(spot)
            self._check_hand_empty(self._check_ready())
            with self.assume_motion():
                held = self._pick(spot, self._choose_grip(grip, spot.pose, kind))
            if not held:
                raise self._make_not_taken_error(source)

    @off_loop
    def unlid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        """Take the lid off the plate at ``source`` and put it into the nest ``target``. ``kind`` is the type
        of the lid, ``plate`` the type of the plate."""
        ends = End(source, source_grip, plate, up_mm=self._lid_mm), End(target, target_grip, kind)
        self._transfer(*ends)

    @off_loop
    def relid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        """Put the lid from the nest ``source`` onto the plate at ``target``."""
        ends = End(source, source_grip, kind), End(target, target_grip, plate, up_mm=self._lid_mm)
        self._transfer(*ends)

    @off_loop
    def put_down(self, target: str, kind: str = "", through: str = "") -> None:
        """Put down what the fingers hold, with their present grip."""
        with self.motion():
            spot = self._find_spot(target, kind, through)
            self._check_reach(spot)
            width = self._check_ready()[GRIPPER]
            fingers = self._hand.read(width)
            if fingers.state in ("open", "shut"):
                raise self.make_refusal("its hand is empty")
            # The lab knows that the hand holds something, even if the width does not show it.
            grip = fingers.grip or self._hand.guess_grip(width, kind)
            self._hand.grasp(grip, width)
            with self.assume_motion():
                self._place(spot, grip)

    @off_loop
    def open_fingers(self, wide: bool) -> None:
        """Open the fingers in the air. Before, a person has checked that nothing is between them."""
        with self.motion():
            with self.report_no_effects():
                self._check_power()
                self._attach()
                width = self._read_joints()[GRIPPER]
                if self._hand.read(width).state == "holding":
                    raise self._make_hand_full_error()
            with self.assume_motion():
                self._release(self._hand.find_grip("wide" if wide else "narrow", ""))

    @off_loop
    def explore(self) -> None:
        """Move to above every taught place, with an empty hand."""
        with self.motion():
            spots = [self._find_spot(name) for name in self._setup.poses]
            for kind, poses in self._setup.poses_of.items():
                spots += [
                    self._find_spot(name, kind)._replace(name=f"{name} with a {kind}") for name in poses
                ]
            for spot in spots:
                self._check_reach(spot)
            self._check_hand_empty(self._check_ready())
            with self.assume_motion():
                for spot in spots:
                    self._come(spot)
                    self._leave(spot)

    # -- by hand -----------------------------------------------------------------------------

    @off_loop
    def free(self, column: bool) -> None:
        """Let a person move the joints by hand. The arm need not be homed or within its limits: free mode is
        the way to bring it back into them."""
        with self.motion():
            with self.report_no_effects():
                self._check_power()
                self._attach()
                self._check_hand_empty(self._read_joints())
            with self.assume_motion():
                self._is_free = True
                for axis in (*protocol.YIELDING, *([protocol.COLUMN] if column else [])):
                    self._ask(protocol.yields(axis))

    @off_loop
    def hold(self) -> None:
        """End free mode, then move up and fold, at low speed."""
        with self.motion():
            with self.report_no_effects():
                self._check_power()
                self._attach()
                self._ask(protocol.ALL_HOLD)
                self._is_free = False
                self._set_profiles(slow=True)
            with self.assume_motion():
                self._lift_and_fold()

    @during_motion
    def read_pose(self) -> list[float]:
        return list(self._read_joints())

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """Switch the power on, home the arm if necessary, then move straight up and fold. From a shelf, it
        moves back through the approach poses instead. The hand keeps what it holds."""
        self.resume()
        if self._ask_number("hp") != protocol.ON:
            power_s = self.limit_s("power", POWER_S)
            self._ask(f"hp 1 {power_s:g}", power_s + self.limit_s("answer", ANSWER_S))
        self._attach()
        self._ask(protocol.ALL_HOLD)
        self._is_free = None
        with self.assume_motion():
            if self._ask_number(f"pd {protocol.HOMED}") != protocol.ON:
                self._ask("home", self.limit_s("home", HOME_S))
            self._set_profiles(slow=True)
            self._lift_and_fold()

    @during_motion
    def stop(self) -> None:
        """Halt the arm where it is. The power stays on, and the hand keeps what it holds. During homing and
        motions of the fingers, the controller executes ``halt`` only afterwards."""
        self._halted.set()
        self._ask("halt", self.limit_s("home", HOME_S))

    @during_motion
    def is_idle(self) -> bool:
        before = self._read_joints()
        time.sleep(POLL_S)
        return _find_difference(before, self._read_joints()) < STILL

    @during_motion
    def observe(self) -> dict[str, Any]:
        """Whether the hand holds something, from the width of its fingers: the width of a plate means yes,
        the open width no. Nothing is reported for any other width. ``free`` is reported if it is known."""
        seen: dict[str, Any] = {} if self._is_free is None else {"free": self._is_free}
        state = self._hand.read(self._read_joints()[GRIPPER]).state
        if state in ("holding", "open"):
            seen["labware"] = {"gripper": state == "holding"}
        return seen

    # -- one transfer ------------------------------------------------------------------------

    def _transfer(self, source: End, target: End, slow: bool = False, turn_at: str = "") -> None:
        turn_at = turn_at or self._setup.regrip
        with self.motion():
            take, put = (
                self._find_spot(end.place, end.kind, end.approach).raise_by(end.up_mm)
                for end in (source, target)
            )
            carried = target.kind if source.up_mm else source.kind
            grips = (
                self._choose_grip(source.grip, take.pose, carried),
                self._choose_grip(target.grip, put.pose, carried),
            )
            turn = self._plan_regrip(*grips, carried, turn_at) if source.grip and target.grip else ()
            for spot in (take, put, *turn):
                self._check_reach(spot)
            self._check_hand_empty(self._check_ready(slow))
            with self.assume_motion():
                held = self._pick(take, grips[0])
                if held and turn:
                    self._place(turn[0], grips[0])
                    held = self._pick(turn[1], grips[1])
                    if not held:
                        raise DeviceError(f"{self.name}: the plate is lost at {turn_at}.")
                if held:
                    self._place(put, grips[1] if turn else grips[0])
            if not held:
                raise self._make_not_taken_error(source.place)

    def _plan_regrip(self, before: Grip, after: Grip, kind: str, place: str) -> tuple[Spot, ...]:
        """The spots for putting the plate down and picking it up at the regrip place. Empty if the grip does
        not change. The place was taught for the narrow grip. Raises DeviceError."""
        if before.name == after.name:
            return ()
        if not place:
            raise self.make_refusal(
                f"it has no place where it could change from {before.name} to {after.name}",
                "Write `regrip:` for the module in the workcell file, or `rotation_deck:` for a step.",
            )
        narrow = self._find_spot(place, kind)
        pose = kinematics.turn_hand(narrow.pose, 90.0, self._limits)
        if pose is None:
            raise self.make_refusal(
                f"it cannot turn its hand at {place}", "Teach this place nearer to the rail, or another one."
            )
        wide = narrow._replace(pose=pose)
        return (narrow, wide) if before.name == "narrow" else (wide, narrow)

    def _pick(self, spot: Spot, grip: Grip) -> bool:
        """Take a plate, and move back. Returns whether the fingers hold something. If it is so wide that the
        fingers would look open, they release it where it stood."""
        self._release(grip)
        self._come(spot)
        self._go(spot.pose, APPROACH)
        answer = self._ask(
            f"GraspPlate {grip.closed_mm:g} {FINGERS_PERCENT} {FORCE_N}", self.limit_s("fingers", FINGERS_S)
        )
        width = self._read_joints()[GRIPPER]
        self._too_wide_mm = width if answer == "-1" and self._hand.looks_open(width) else None
        held = answer == "-1" and self._too_wide_mm is None
        if held:
            self._hand.grasp(grip, width)
        else:
            self._release(grip)
        self._leave(spot)
        return held

    def _make_not_taken_error(self, place: str) -> DeviceError:
        """The error for an arm that has moved back without a plate."""
        if self._too_wide_mm is not None:
            return self.make_refusal(
                f"what stands at {place} is {self._too_wide_mm:.1f} mm wide between the "
                "fingers, as if they were open; it was let go where it stood",
                "Say how wide it is gripped: `grips_of:` in the module's config.",
            )
        return self.make_refusal(
            f"nothing came between the fingers at {place}",
            "Look whether a plate is there, and where it was taught.",
        )

    def _place(self, spot: Spot, grip: Grip) -> None:
        self._come(spot)
        self._go(spot.pose, APPROACH)
        if self._hand.read(self._read_joints()[GRIPPER]).state != "holding":
            raise DeviceError(
                f"{self.name}: it has lost what it held on its way.",
                remedy="Look where the plate is, then reset the module.",
            )
        self._release(grip)
        self._leave(spot)

    def _come(self, spot: Spot) -> None:
        """Move to above a place, through the poses that lead there."""
        self._fold((spot.through or (spot.pose,))[0][RAIL])
        self._inside = spot if spot.through else None
        for pose in spot.through:
            self._go(pose, TRAVEL)
        self._go(spot.above, APPROACH if spot.through else TRAVEL)

    def _leave(self, spot: Spot) -> None:
        """Move up, then back through the same poses, and fold."""
        self._go(spot.above, APPROACH)
        for pose in reversed(spot.through):
            self._go(pose, APPROACH)
        self._inside = None
        self._fold((spot.through or (spot.pose,))[0][RAIL])

    def _fold(self, rail: float) -> None:
        """Fold the arm close to the column, then move along the rail."""
        here = self._read_joints()
        if not self._is_folded(here):
            self._go((*self._neutral, 0.0, here[RAIL]), TRAVEL)
        self._go((*self._neutral, 0.0, rail), TRAVEL)

    def _release(self, grip: Grip) -> None:
        self.check_not_stopped()
        self._hand.forget()
        self._ask(f"ReleasePlate {grip.open_mm:g} {FINGERS_PERCENT}", self.limit_s("fingers", FINGERS_S))

    # -- one motion --------------------------------------------------------------------------

    def _go(self, pose: Joints, profile: int) -> None:
        """Move to a pose, and wait until the arm stands still there. The fingers keep their width."""
        self.check_not_stopped()
        fingers = self._read_joints()[GRIPPER]
        joints = (*pose[:GRIPPER], fingers, *pose[RAIL:])
        sent = joints if self._stands_on_rail() else joints[:RAIL]
        self._ask(f"movej {profile} " + " ".join(f"{value:.3f}" for value in sent))
        began = time.monotonic()
        before = self._read_joints()
        while True:
            if self._halted.is_set():
                # The motion command may have been sent after the ``halt``.
                self._ask("halt")
                self.check_not_stopped()
            time.sleep(POLL_S)
            here = self._read_joints()
            at_rest, before = _find_difference(here, before) < STILL, here
            passed_s = time.monotonic() - began
            if at_rest and _find_difference(here, joints) < NEAR:
                return
            # Just after the command, the arm may not have begun to move.
            if (at_rest and passed_s > self.limit_s("begin", BEGIN_S)) or passed_s > self.limit_s(
                "move", MOVE_S
            ):
                raise self._make_stopped_short_error(joints, here)

    def _make_stopped_short_error(self, wanted: Joints, here: Joints) -> DeviceError:
        axis = max((n for n in range(6) if n != GRIPPER), key=lambda n: abs(wanted[n] - here[n]))
        state = self._ask_number("sysState")
        why = "the emergency stop is pressed" if state == protocol.HARD_STOP else f"system state {state}"
        return DeviceError(
            f"{self.name}: the arm stopped short: {protocol.AXES[axis]} at {here[axis]:.1f}, not at "
            f"{wanted[axis]:.1f} ({why}).",
            remedy=protocol.COLLIDED,
        )

    def _check_ready(self, slow: bool = False) -> Joints:
        """The position of the arm, after it was attached and its speeds were set. Raises DeviceError, before
        anything moves, if the arm may not move from there."""
        with self.report_no_effects():
            self._check_power()
            if self._is_free:
                raise DeviceError(
                    f"{self.name}: somebody guides it by hand.", remedy="Step back, then end_free_mode."
                )
            if self._ask_number(f"pd {protocol.HOMED}") != protocol.ON:
                raise DeviceError(f"{self.name}: it is not homed.", remedy="Reset the module.")
            self._attach()
            here = self._read_joints()
            if not self._is_folded(here):
                raise DeviceError(
                    f"{self.name}: the arm is not folded, so that its way is not known to be free.",
                    remedy="See that nothing is above it, then reset the module.",
                )
            self._set_profiles(slow)
        return here

    def _lift_and_fold(self) -> None:
        here = self._read_joints()
        if self._is_folded(here):
            return
        inside = self._find_reached_place(here)
        if inside is not None:
            self._leave(inside)
            return
        self._go(_raise_pose(here, self._neutral[0] - here[0]), TRAVEL)
        self._fold(here[RAIL])

    def _find_reached_place(self, here: Joints) -> Spot | None:
        """The place with an approach, such as a shelf, in which the hand is. There the hand must not move
        straight up: it would hit what is above. None if the hand is in no such place."""
        taught = {place_of(self._setup, name) for name in self._setup.poses}
        spots = [self._find_spot(name) for name in self._through if name in taught]
        spots += [self._inside] if self._inside is not None else []
        at = kinematics.find_hand(here)[:2]
        near = [(dist(at, kinematics.find_hand(spot.pose)[:2]), spot) for spot in spots]
        near = [(away, spot) for away, spot in near if away <= INSIDE_MM]
        if not near:
            return None
        spot = min(near, key=lambda pair: (abs(here[0] - pair[1].pose[0]), pair[0]))[1]
        up_mm = max(here[0] - spot.pose[0], 0.0)
        return spot._replace(above_mm=min(up_mm, spot.above_mm))

    def _is_folded(self, joints: Joints) -> bool:
        return all(abs(a - b) < FOLDED for a, b in zip(joints[1:4], self._neutral[1:], strict=True))

    def _check_power(self) -> None:
        if self._ask_number("hp") != protocol.ON:
            raise DeviceError(f"{self.name}: its power is off.", remedy="Reset the module.")

    def _attach(self) -> None:
        if self._ask_number("attach") == 0:
            self._ask("attach 1")

    def _set_profiles(self, slow: bool = False) -> None:
        for profile, percent in ((APPROACH, APPROACH_PERCENT), (TRAVEL, self._speed)):
            speed = min(percent, self._speed) / (SLOWER if slow else 1.0)
            self._ask(f"Profile {profile} {speed:.1f} 0 {speed:.1f} {speed:.1f} 0.1 0.1 10 0")

    def _check_hand_empty(self, here: Joints) -> None:
        state = self._hand.read(here[GRIPPER]).state
        if state == "holding":
            raise self._make_hand_full_error()
        if state != "open":
            raise self.make_refusal(
                f"it is not known whether its hand is empty: the fingers are "
                f"{here[GRIPPER]:.1f} mm apart; open they are {self._hand.describe_widths()}",
                "Look. If it holds something: put_down. If it does not: open_fingers. A plate of this "
                "width is described by `grips_of:` in the module's config.",
            )

    def _make_hand_full_error(self) -> DeviceError:
        return self.make_refusal("its hand is full", "Put down what it holds: put_down.")

    def _choose_grip(self, wanted: str, pose: Joints, kind: str) -> Grip:
        """The requested grip. If none is requested, the grip with which the place was taught."""
        side = wanted or ("wide" if pose[GRIPPER] > BETWEEN_GRIPS_MM else "narrow")
        return self._hand.find_grip(side, kind)

    # -- places ------------------------------------------------------------------------------

    def _find_spot(self, place: str, kind: str = "", through: str = "") -> Spot:
        """The spot of a place. Raises DeviceError if this place, or one on the way, was not taught."""
        here = place_of(self._setup, place)
        ways = _list_names(through) if through else self._through.get(here, ())
        above_mm = self._above_mm_of.get(here, self._above_mm)
        return Spot(
            place, self._find_pose(place, kind), tuple(self._find_pose(name, kind) for name in ways), above_mm
        )

    def _find_pose(self, place: str, kind: str = "") -> Joints:
        """The pose that was taught for this labware type, else for all types. Raises DeviceError."""
        poses = {place_of(self._setup, name): pose for name, pose in self._setup.poses_for(kind).items()}
        pose = poses.get(place_of(self._setup, place))
        joints = len(protocol.AXES) if self._stands_on_rail() else RAIL
        if pose is None or not joints <= len(pose) <= len(protocol.AXES):
            wrong = "was not taught" if pose is None else f"was taught with {len(pose)} joints, not {joints}"
            raise self.make_refusal(
                f"the place {place} {wrong}", "Teach it: `locations:` of the workcell file."
            )
        return tuple(pose) if self._stands_on_rail() else (*pose[:RAIL], 0.0)

    def _stands_on_rail(self) -> bool:
        """Whether the arm stands on a rail. With a rail it reports six joints, without one five."""
        if self._has_rail is None:
            self._read_joints()
        return bool(self._has_rail)

    def _check_reach(self, spot: Spot) -> None:
        """Raise DeviceError, before anything moves, if the arm cannot reach a place."""
        for pose in (spot.pose, spot.above, *spot.through):
            for axis, (low, high) in enumerate(self._limits):
                value = pose[axis]
                if not low <= value <= high and axis != GRIPPER:
                    raise self.make_refusal(
                        f"{spot.name} is out of reach: {protocol.AXES[axis]} at {value:g}, "
                        f"limits {low:g} to {high:g}",
                        "Teach the place again.",
                    )

    # -- one command -------------------------------------------------------------------------

    def _ask(self, question: str, timeout_s: float = 0.0) -> str:
        """Send a command, and return the data of its reply. Raises DeviceError for a negative code."""
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

    def _ask_number(self, question: str) -> int:
        data = self._ask(question)
        try:
            return int(float(data))
        except (ValueError, OverflowError) as error:
            raise Garbled(f"{self.name}: {data!r} is no number, the answer to {question!r}.") from error

    def _read_joints(self) -> Joints:
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
        kind = self._ask_number(f"pd {protocol.ROBOT_TYPE}")
        self._limits = self._read_soft_limits()
        if kind != protocol.PF400:
            return f"a robot of type {kind}"
        self.check_unit(self._ask_if_known(f"pd {protocol.SERIAL_NUMBER}"))
        self.note_firmware(self._ask_if_known("version"))
        return WHO

    def _ask_if_known(self, command: str) -> str:
        """The data of the controller's reply. Empty if the controller refuses the command."""
        try:
            return self._ask(command).strip('" ')
        except LinkError:
            raise
        except DeviceError:
            return ""

    def _read_soft_limits(self) -> list[tuple[float, float]]:
        """The limits of each axis: the narrower ones of the driver's and the arm's own. Columns and rails
        differ in length: for them, the limits that the arm reports replace the driver's."""
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


def _raise_pose(pose: Joints, up_mm: float) -> Joints:
    return (pose[0] + up_mm, *pose[1:])


def _find_difference(one: Joints, other: Joints) -> float:
    """The largest difference of any axis except the fingers: they yield to what they hold."""
    pairs = zip(one, other, strict=True)
    return max(abs(a - b) for axis, (a, b) in enumerate(pairs) if axis != GRIPPER)


def _list_names(configured: Any) -> tuple[str, ...]:
    """The names in a setting that has one name or a list of names."""
    return (configured,) if isinstance(configured, str) else tuple(map(str, configured))
