"""What the drivers of arms of Hudson Robotics share: the protocol, and the motions that carry a plate.

Messages are ASCII lines that end with carriage return and line feed. The device first repeats the command:
this echo is not the reply. Then comes a line with a code (zero: done) or with data; for a motion, it comes
at the end. For an absolute move, the driver stores a point, moves to it and deletes it. The axes are R
(rotation of the arm), Z (height, lower is more negative), P (rotation of the hand) and Y (reach).

Sources: AD-SDL/hudson_platecrane_module, src/platecrane_driver (platecrane_driver.py, sciclops_driver.py
and its later rewrite); AD-SDL/sciclops_module. No manual is public.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, ClassVar, Protocol

import msgspec

from labos.errors import DeviceError, Garbled, NoReply
from labos.link import Link, Terminated, Wire
from labos.node import Setup
from labos_drivers._limits import make_serial_wire
from labos_drivers._simulation import place_of
from labos_drivers._wired import DeviceOnWire, Wired, off_loop

BAUDRATE = 9600
END = b"\r\n"
ECHO_S, ANSWER_S, MOTION_S, HOME_S = 10.0, 10.0, 60.0, 90.0
LATER_S = 1.0
"""How long to wait for a further line of an answer."""
NOT_HOMED = "0"
READY_STATUS = ("1",)
POINT = "TEMP"
RESULT = re.compile(r"(\d{4})(?:\s+(.*))?")


class Joints(msgspec.Struct, frozen=True):
    """The positions of the four axes, in the device's own units."""

    r: float
    z: float
    p: float
    y: float

    @classmethod
    def of(cls, axes: Mapping[str, Any]) -> Joints:
        """The joints with values by the letters of the axes. Raises ValueError if an axis is missing."""
        if len(axes) != len(cls.__struct_fields__):
            raise ValueError(f"{', '.join(axes)} are not all axes")
        return cls(**{axis.lower(): float(value) for axis, value in axes.items()})

    def replace(self, **axes: float) -> Joints:
        return msgspec.structs.replace(self, **axes)

    def distance_to(self, other: Joints) -> float:
        return max(abs(a - b) for a, b in zip(self.as_tuple(), other.as_tuple(), strict=True))

    def as_tuple(self) -> tuple[float, float, float, float]:
        return self.r, self.z, self.p, self.y


class Dialect(Protocol):
    """The format of the commands and replies of one device model."""

    who: str
    order: str
    """The axes in the order of ``GETPOS``, and of taught poses."""
    unit: float
    """Device units of Z in a mm."""

    def load(self, name: str, joints: Joints) -> str:
        """The command that stores a point."""

    def read(self, text: str) -> Joints:
        """The joints in a reply to ``GETPOS``. Raises ValueError."""

    def speed(self, percent: float) -> str:
        """The command that sets the speed."""


class Sizes(msgspec.Struct, frozen=True):
    """Sizes of the plates in mm, and of the arm in its own units. The module's config can change them."""

    plate_mm: float
    grip_mm: float
    lid_mm: float
    clear_mm: float
    travel_z: float
    retracted_y: float
    near: float


class HudsonDriver(Wired):
    """Moves one axis after the other: up (Z), in (Y), rotate (R and P), out (Y), down (Z). After each motion
    it reads the position of the arm. The device has no stop command."""

    deadlines = ("echo", "answer", "motion", "home", "later")
    dialect: ClassVar[Dialect]
    sizes: ClassVar[Sizes]
    limits: ClassVar[dict[str, tuple[float, float]]]
    codes: ClassVar[dict[int, str]]
    stacks: ClassVar[tuple[str, ...]]
    speed_percent: ClassVar[float]
    link: Link

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        config = setup.config
        configured = {name: float(config[name]) for name in Sizes.__struct_fields__ if name in config}
        self._sizes = msgspec.structs.replace(self.sizes, **configured)
        self._speed = min(float(config.get("speed_percent", self.speed_percent)), 100.0)
        self._limits = {**self.limits, **(config.get("limits") or {})}
        self._ready_status = tuple(map(str, config.get("ready_status", READY_STATUS)))
        self._stacks = {place_of(setup, stack) for stack in self.stacks}
        self.link = Link(
            self.wire(address),
            Terminated(END),
            name=setup.name,
            # By this echo, the link distinguishes the reply from one to an earlier command.
            answers=lambda question, line: line.strip() == question,
            identify=lambda _: self._recognise(),
            expected=self.dialect.who,
        )

    def wire(self, address: str) -> Wire:
        return make_serial_wire(self._setup, address, baudrate=BAUDRATE)

    # -- plates ------------------------------------------------------------------------------

    @off_loop
    def transfer(self, source: str, target: str, raised: float = 0.0) -> None:
        """Carry a plate. Both poses are higher than taught by ``raised`` (in device units)."""
        self._carry((source, raised), (target, raised))

    @off_loop
    def remove_lid(self, plate_at: str, nest: str) -> None:
        self._carry((plate_at, self._lid_height()), (nest, 0.0))

    @off_loop
    def replace_lid(self, nest: str, plate_at: str) -> None:
        self._carry((nest, 0.0), (plate_at, self._lid_height()))

    @off_loop
    def put_down(self, target: str) -> None:
        with self.motion():
            with self.report_no_effects():
                pose = self._find_pose(target)
                self._check_ready()
                if not self._is_holding():
                    raise DeviceError(f"{self.name}: its hand is empty.")
            with self.assume_motion():
                self._place(target, pose)

    @off_loop
    def home(self) -> None:
        """Home all axes. The arm moves through a large volume."""
        with self.motion(), self.assume_motion():
            self._home()

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """Move up and in if the arm is homed and accepts it; then home. The hand keeps what it holds."""
        self.resume()
        with self.assume_motion():
            self._home()

    @off_loop
    def is_idle(self) -> bool:
        """Whether the arm is ready. During a motion, the reply comes only at its end."""
        return self._read_status() in self._ready_status

    @off_loop
    def observe(self) -> dict[str, Any]:
        """Whether the fingers hold something: then they are neither open nor fully closed. Empty if the
        sensors report both open and closed."""
        held = self._read_fingers()
        return {} if held is None else {"labware": {"gripper": held}}

    # -- one transfer ------------------------------------------------------------------------

    def _carry(self, source: tuple[str, float], target: tuple[str, float]) -> None:
        with self.motion():
            with self.report_no_effects():
                take, put = (self._find_pose(place, up) for place, up in (source, target))
                self._check_ready()
                if self._is_holding():
                    raise DeviceError(f"{self.name}: its hand is full.", remedy="Put down what it holds.")
            with self.assume_motion():
                why = self._pick(source[0], take)
                if not why:
                    self._place(target[0], put)
            if why:
                raise DeviceError(
                    f"{self.name}: {why}", effects="none", remedy="Look whether a plate is there."
                )

    def _pick(self, place: str, pose: Joints) -> str:
        """Take a plate and move up. Returns an empty text if something is between the fingers, else the
        reason why nothing is."""
        if place_of(self._setup, place) in self._stacks:
            return self._pick_from_stack(place, pose)
        self._move_over(pose)
        self._do("OPEN")
        self._move_to(self._read_position().replace(z=pose.z))
        return self._close_and_lift(f"nothing came between the fingers at {place}.")

    def _pick_from_stack(self, place: str, floor: Joints) -> str:
        """Take the topmost plate of a stack; returns as ``_pick``. The closed fingers first move down until
        they touch it: there is no other way to measure the height of a stack."""
        unit = self.dialect.unit
        self._move_over(floor)
        self._do("CLOSE")
        top = self._touch(floor.z)
        if top - floor.z < self._sizes.near + unit:
            self._lift()
            self._do("OPEN")
            return f"{place} is empty, the gripper touched the floor."
        self._move_to(self._read_position().replace(z=top + self._sizes.clear_mm * unit))
        self._do("OPEN")
        deep = (self._sizes.plate_mm - self._sizes.grip_mm) * unit
        self._move_to(self._read_position().replace(z=max(top - deep, floor.z)))
        return self._close_and_lift(f"nothing came between the fingers at {place}.")

    def _close_and_lift(self, otherwise: str) -> str:
        self._do("CLOSE")
        held = self._is_holding()
        if not held:
            self._do("OPEN")
        self._lift()
        return "" if held else otherwise

    def _place(self, place: str, pose: Joints) -> None:
        self._move_over(pose)
        if not self._is_holding():
            raise DeviceError(
                f"{self.name}: it has lost what it held on its way.",
                remedy="Look where the plate is, then reset the module.",
            )
        if place_of(self._setup, place) in self._stacks:
            # The plate in the hand touches the stack before the fingers do.
            self._touch(pose.z)
        else:
            self._move_to(self._read_position().replace(z=pose.z))
        self.check_not_stopped()
        self._do("OPEN")
        self._lift()

    # -- one motion --------------------------------------------------------------------------

    def _move_over(self, pose: Joints) -> None:
        self._lift()
        self._move_to(self._read_position().replace(y=self._sizes.retracted_y))
        self._move_to(self._read_position().replace(r=pose.r, p=pose.p))
        self._move_to(self._read_position().replace(y=pose.y))

    def _lift(self) -> None:
        self._move_to(self._read_position().replace(z=self._sizes.travel_z))

    def _move_to(self, target: Joints) -> None:
        """Move the arm, unless it is there already. The reply comes at the end of the motion. Raises
        DeviceError if the arm is not at the target then."""
        if target.distance_to(self._read_position()) <= self._sizes.near / 10:
            return
        self.check_not_stopped()
        self._do(self.dialect.load(POINT, target))
        self._do(f"MOVE {POINT}", self.limit_s("motion", MOTION_S))
        here = self._read_position()
        if here.distance_to(target) > self._sizes.near:
            raise DeviceError(
                f"{self.name}: the arm stopped short, at {_describe(here)} and not at {_describe(target)}.",
                remedy="Look at the arm and at what it holds, then reset the module.",
            )
        self._do(f"DELETEPOINT {POINT}")

    def _touch(self, floor: float) -> float:
        """Move down until the hand touches something, at most to ``floor``. Returns the height (Z)."""
        self.check_not_stopped()
        self._do(f"JOG Z,{_format_number(floor - self._read_position().z)}", self.limit_s("motion", MOTION_S))
        return self._read_position().z

    def _home(self) -> None:
        self._do(self.dialect.speed(self._speed))
        if self._read_status() != NOT_HOMED:
            with suppress(_Refused):  # in an error state, the arm accepts only `HOME`
                self._lift()
                self._move_to(self._read_position().replace(y=self._sizes.retracted_y))
        self._do("HOME", self.limit_s("home", HOME_S))

    def _check_ready(self) -> None:
        """Check that the arm is homed and ready, and set its speed. Raises DeviceError if it is not."""
        status = self._read_status()
        if status == NOT_HOMED:
            raise DeviceError(f"{self.name}: it is not homed.", remedy="Reset the module.")
        if status not in self._ready_status:
            raise DeviceError(
                f"{self.name}: its status is {status!r}, which is not known to mean that it is ready.",
                remedy="Look at the arm, then reset the module. If it was ready: `ready_status:` in the "
                "module's config lists what it says then.",
            )
        self._do(self.dialect.speed(self._speed))

    def _read_status(self) -> str:
        """The first word of the reply to ``STATUS``; empty if there is none."""
        return next(iter(self._ask("STATUS", lambda text: text[:1].isdigit()).split()), "")

    def _is_holding(self) -> bool:
        """Whether something is between the fingers. Raises DeviceError if the sensors contradict each
        other."""
        held = self._read_fingers()
        if held is None:
            raise DeviceError(
                f"{self.name}: its sensors say that its fingers are open and shut at once: whether it holds "
                "something is not known.",
                remedy="Look at the hand and take out what it holds, check the sensors of its fingers, then "
                "reset the module.",
            )
        return held

    def _read_fingers(self) -> bool | None:
        """Whether the fingers are neither open nor fully closed; None if the sensors report both."""
        is_open, is_shut = (self._ask_yes_or_no(q) for q in ("GETGRIPPERISOPEN", "GETGRIPPERISCLOSED"))
        return None if is_open and is_shut else not (is_open or is_shut)

    def _ask_yes_or_no(self, question: str) -> bool:
        text = self._ask(question, _is_yes_or_no)
        words = re.findall("true|false", text.lower())
        if len(words) != 1:
            raise Garbled(f"{self.name}: {text!r} does not tell where the fingers are ({question}).")
        return bool(words[0] == "true")

    def _read_position(self) -> Joints:
        text = self._ask("GETPOS", self._is_position)
        try:
            return self.dialect.read(text)
        except ValueError as error:
            raise Garbled(f"{self.name}: {text!r} does not say where the arm is.") from error

    # -- places ------------------------------------------------------------------------------

    def _find_pose(self, place: str, raised: float = 0.0) -> Joints:
        """The pose of a place from the workcell file, else from the point that is stored in the device.
        Raises DeviceError if there is none, or if it is out of reach."""
        poses = {place_of(self._setup, name): pose for name, pose in self._setup.poses.items()}
        full = place_of(self._setup, place)
        taught = poses.get(full)
        if taught is not None and len(taught) != 4:
            raise self.make_refusal(
                f"the place {place} was taught with {len(taught)} axes, not four",
                "Teach it again: `locations:` of the workcell file.",
            )
        if taught and any(taught):
            pose = Joints.of(dict(zip(self.dialect.order, taught, strict=True)))
        else:
            pose = self._read_point(place, full.removeprefix(f"{self.name}.").replace(".", "_"))
        pose = pose.replace(z=pose.z + raised)
        for axis, value in zip("RZPY", pose.as_tuple(), strict=True):
            low, high = self._limits[axis]
            if not low <= value <= high:
                raise self.make_refusal(
                    f"{place} is out of reach: {axis} at {value:g}, limits {low:g} to {high:g}",
                    "Teach the place again.",
                )
        return pose

    def _read_point(self, place: str, name: str) -> Joints:
        try:
            return self.dialect.read(self._ask(f"GETPOINT {name}", self._is_position))
        except (_Refused, ValueError) as error:
            raise self.make_refusal(
                f"the place {place} was not taught, and the device has no point {name}",
                "Teach it: `locations:` of the workcell file.",
            ) from error

    def _is_position(self, text: str) -> bool:
        try:
            self.dialect.read(text)
        except ValueError:
            return False
        return True

    def _lid_height(self) -> float:
        return self._sizes.lid_mm * self.dialect.unit

    # -- one question ------------------------------------------------------------------------

    def _ask(self, question: str, is_data: Callable[[str], bool]) -> str:
        """Send a question; returns the data of its reply, which comes behind the code or on a later line. It
        is the first text that ``is_data``, else the last one. Raises DeviceError for a nonzero code."""
        line = self._read_result(question, self.limit_s("answer", ANSWER_S))
        while True:
            found = RESULT.fullmatch(line)
            if found is not None and int(found[1]):
                raise self._make_error(question, int(found[1]), line, "none")
            text = line if found is None else found[2] or ""
            if is_data(text):
                return text
            try:
                line = self._read_line(self.limit_s("later", LATER_S))
            except NoReply:
                return text

    def _do(self, command: str, limit_s: float = 0.0) -> None:
        """Send a command and wait for its end, when the device replies with a code. Raises DeviceError."""
        line = self._read_result(command, limit_s or self.limit_s("answer", ANSWER_S))
        code = line.split()[0] if line.split() else ""
        if not re.fullmatch(r"\d{2}|\d{4}", code):
            raise Garbled(f"{self.name}: {line!r} is no result of {command}.")
        if int(code):
            raise self._make_error(command, int(code), line, "unknown")

    def _read_result(self, command: str, limit_s: float) -> str:
        """Send a command; returns the line after its echo."""
        self.link.exchange(command.encode(), self.limit_s("echo", ECHO_S))
        return self._read_line(limit_s)

    def _read_line(self, limit_s: float) -> str:
        deadline = time.monotonic() + limit_s
        while True:
            line = self.link.receive(max(deadline - time.monotonic(), 0.0))
            if text := line.strip().decode("ascii", "replace"):
                return text

    def _make_error(self, command: str, code: int, line: str, effects: str) -> _Refused:
        return _Refused(
            f"{self.name}: Hudson error {line}: {self.codes.get(code, 'an unknown error')} (to {command}).",
            effects=effects,
            remedy="Look at the arm and at what it holds, then reset the module.",
        )

    def _recognise(self) -> str:
        text = self._ask("GETPOS", lambda text: bool(re.search(r"Z:|-?\d+,", text)))
        who = "a SciClops" if "Z:" in text else "a PlateCrane"
        if who == self.dialect.who and not self._is_position(text):
            return f"what answers {text!r}"
        return who


def _is_yes_or_no(text: str) -> bool:
    return "true" in text.lower() or "false" in text.lower()


class _Refused(DeviceError):
    """The device has replied with a code other than zero."""


def _format_number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")


def _describe(joints: Joints) -> str:
    return ", ".join(
        f"{axis} {_format_number(value)}" for axis, value in zip("RZPY", joints.as_tuple(), strict=True)
    )


class SciclopsDialect:
    """Positions in millimetres and degrees, with the letters of the axes."""

    who = "a SciClops"
    order = "ZRYP"
    unit = 1.0

    def load(self, name: str, joints: Joints) -> str:
        r, z, p, y = map(_format_number, joints.as_tuple())
        return f"LOADPOINT {name}, Z:{z}, P:{p}, Y:{y}, R:{r}"

    def read(self, text: str) -> Joints:
        return Joints.of(dict(re.findall(r"([RZPY]):\s*(-?\d+(?:\.\d+)?)", text)))

    def speed(self, percent: float) -> str:
        return f"SETSPEED {percent:.0f}"


class PlateCraneDialect:
    """Positions in motor steps, without the letters of the axes."""

    who = "a PlateCrane"
    order = "RZPY"
    unit = 80.5

    def load(self, name: str, joints: Joints) -> str:
        return f"LOADPOINT {name}, " + ", ".join(f"{value:.0f}" for value in joints.as_tuple())

    def read(self, text: str) -> Joints:
        steps = [int(part) for part in text.split(",")]
        if len(steps) != 4:
            raise ValueError(text)
        return Joints(*map(float, steps))

    def speed(self, percent: float) -> str:
        return f"SPEED {percent:.0f}"
