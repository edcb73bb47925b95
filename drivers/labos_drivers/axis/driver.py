"""The driver of a CANopen drive with the profile CiA 402, by service data objects.

A drive continues its motion by itself if the connection is lost. Afterwards, its state belongs to this
attempt only if the motor still has power, and mode and target are the requested ones. In homing, the start
bit must still be set. A drive that was switched off in between keeps no record. A motion starts with an edge
of one bit, which the driver sends once.
"""

from __future__ import annotations

import threading
import time
from typing import Any, ClassVar

import msgspec

from labos.errors import DeviceError, LinkError, NotConnected, OutcomeUnknown
from labos.node import Setup
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop
from labos_drivers.axis import profile
from labos_drivers.axis.objects import Drive
from labos_drivers.axis.profile import State, state_of
from labos_drivers.axis.table import AxisTable

POLL_S = 0.05
STATE_S = 3.0
"""For so long a drive may take from one state to the next."""

BEGIN_S = 1.0
"""A drive that has taken a start shows it within this time."""

PATIENCE_S = 30.0
"""For so long a drive that does not answer is asked again in mid-motion."""

LONGER, SPARE_S = 3.0, 10.0
"""A motion may last so many times as long as it should, and so much more."""

STANDS = 5
"""How often in a row it must be seen to stand still elsewhere, before that counts."""

SWITCHED_OFF = "the drive lost its power meanwhile, and keeps no record of what was done"
NOT_THIS = "what the drive shows is not of this attempt"
NEVER_BEGAN = "the drive stands still, and not where it was sent"


class Goal(msgspec.Struct, frozen=True):
    """The part of an attempt that the journal keeps: the target (``counts``) or ``homing``, and the time
    limit for the motion (s)."""

    counts: int = 0
    homing: bool = False
    limit_s: float = 60.0


class AxisDriver(Wired):
    """The driver of an axis with this ``table``."""

    deadlines = ("state", "patience")
    where = ("channel", "can0")
    table: ClassVar[AxisTable]

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._commands = threading.Lock()
        self._homed = False
        self.drive = Drive(
            setup.name, address, setup.config, self.check_unit, simulated=simulator is not None
        )
        self.link = self.drive.link

    # -- state -------------------------------------------------------------------------------

    @during_motion
    def is_idle(self) -> bool:
        return not self._is_moving()

    @during_motion
    def read_position(self) -> float:
        """The position, in the axis' unit. Raises DeviceError if the axis is not homed."""
        if not self._is_homed(self.drive.read_status()):
            raise self._make_not_homed_error()
        return self._read_position()

    @during_motion
    def observe(self) -> dict[str, Any]:
        homed = self._is_homed(self.drive.read_status())
        return {"homed": homed} | ({"position": self._read_position()} if homed else {})

    @during_motion
    def trouble(self) -> str:
        """The fault that the drive reports; empty if there is none."""
        return str(self.drive.read_fault()) if state_of(self.drive.read_status()) is State.FAULT else ""

    # -- motions -----------------------------------------------------------------------------

    @off_loop
    def prepare_move(self, position: float, speed: float) -> Goal:
        """Switch the motor's power on, and send target and speed to the drive. Nothing moves. Raises
        DeviceError with the effects ``none``."""
        with self.report_no_effects():
            self._refuse_unless_fit()
            if not self._is_homed(self.drive.read_status()):
                raise self._make_not_homed_error()
            counts = self.table.counts(position)
            self._refuse_beyond_limits(position, counts)
            self._power_on(profile.PROFILE_POSITION)
            raw = self.table.raw_acceleration()
            self.drive.write(profile.SPEED, self.table.raw_speed(speed), 4)
            self.drive.write(profile.ACCELERATION, raw, 4)
            self.drive.write(profile.DECELERATION, raw, 4)
            way = abs(counts - self.drive.read(profile.POSITION_NOW, 4)) / abs(self.table.counts_per_unit)
            self.drive.write(profile.TARGET, counts, 4)
            takes_s = way / speed + 2 * speed / self.table.acceleration
            return Goal(counts, limit_s=LONGER * takes_s + SPARE_S)

    @off_loop
    def prepare_home(self) -> Goal:
        """Switch the motor's power on, and send the homing settings to the drive. Nothing moves. Raises
        DeviceError with the effects ``none``."""
        home, table = self.table.home, self.table
        with self.report_no_effects():
            self._refuse_unless_fit()
            self._power_on(profile.HOMING)
            self.drive.write(profile.HOMING_METHOD, home.method, 1)
            offset = table.counts(home.position if home.offset_is_position else -home.position)
            switch, zero = table.raw_speed(home.switch_speed), table.raw_speed(home.zero_speed)
            self.drive.write(profile.HOME_OFFSET, offset, 4)
            self.drive.write(profile.HOMING_SPEEDS, switch, 4, profile.SWITCH_SPEED)
            self.drive.write(profile.HOMING_SPEEDS, zero, 4, profile.ZERO_SPEED)
            self.drive.write(profile.HOMING_ACCELERATION, table.raw_acceleration(), 4)
            return Goal(homing=True, limit_s=home.timeout)

    @off_loop
    def start(self, goal: Goal) -> bool:
        """Start the motion with one edge of the start bit. Returns whether the drive has answered. Raises
        DeviceError; NotConnected if nothing was sent."""
        word = profile.ENABLE | profile.START
        if goal.homing:
            self._homed = False
        try:
            self._control(word if goal.homing else word | profile.AT_ONCE)
        except NotConnected:
            raise
        except LinkError:
            return False
        return True

    @off_loop
    def await_end(self, goal: Goal, *, sure: bool) -> None:
        """Wait for the end of a motion. ``sure``: the drive has answered the start command, and the
        connection was not lost since then. Raises DeviceError, OutcomeUnknown."""
        with self.assume_motion():
            self._await_end(goal, sure)

    async def stop(self) -> None:
        """Send a quick stop. After it, the motor has no power until the next motion."""
        self._halted.set()
        await self._quick_stop()

    @off_loop
    def reset(self) -> None:
        """Bring the drive out of a fault or a quick stop. Nothing moves, and the motor has no power
        afterwards. Raises DeviceError if the fault remains."""
        state = state_of(self.drive.read_status())
        self._control(profile.DISABLE_VOLTAGE, anyway=True)
        if state in (State.FAULT, State.REACTING):
            self._control(profile.RESET_FAULT, anyway=True)
            self._control(profile.DISABLE_VOLTAGE, anyway=True)
        if state is not State.NOT_READY:
            until = time.monotonic() + self.limit_s("state", STATE_S)
            while state_of(self.drive.read_status()) not in (State.DISABLED, State.READY):
                if time.monotonic() > until:
                    raise self.drive.read_fault()
                time.sleep(POLL_S)
        self.drive.emergency = 0
        self.resume()

    # -- before a motion ---------------------------------------------------------------------

    def _refuse_unless_fit(self) -> None:
        self.check_not_stopped()
        if state_of(self.drive.read_status()) in (State.FAULT, State.REACTING):
            raise self.drive.read_fault()
        if self._is_moving():
            raise DeviceError(f"{self.name} moves.", remedy="Wait until it stands still.")

    def _refuse_beyond_limits(self, position: float, counts: int) -> None:
        """Check the target against the drive's own limits. The limits of the table are checked before, as
        limits of the action's argument. Raises DeviceError."""
        lowest = self.drive.read(profile.LIMITS, 4, profile.LOWEST)
        highest = self.drive.read(profile.LIMITS, 4, profile.HIGHEST)
        if lowest < highest and not lowest <= counts <= highest:
            ends = sorted((self.table.position(lowest), self.table.position(highest)))
            raise DeviceError(
                f"{self.name}: {position:g} {self.table.unit} is beyond the drive's own limits.",
                remedy=f"They are {ends[0]:g} and {ends[1]:g} {self.table.unit} (object 607D).",
            )

    def _power_on(self, mode: int) -> None:
        """Set the mode, and bring the drive step by step into the state ENABLED. Raises DeviceError."""
        self.drive.write(profile.MODE, mode, 1)
        until = time.monotonic() + self.limit_s("state", STATE_S)
        asked = None
        while (state := state_of(self.drive.read_status())) is not State.ENABLED:
            if state in (State.FAULT, State.REACTING):
                raise self.drive.read_fault()
            if time.monotonic() > until:
                raise DeviceError(
                    f"{self.name}: the drive stays in the state {state.name}.",
                    remedy="Check its supply and its enable input.",
                )
            word = profile.NEXT.get(state, profile.DISABLE_VOLTAGE)
            if word != asked:
                asked = word
                self._control(word)
        self._control(profile.ENABLE)  # without the start bit
        while self.drive.read(profile.MODE_NOW, 1) != mode:
            if time.monotonic() > until:
                raise DeviceError(f"{self.name}: the drive does not take the mode {mode}.")
            time.sleep(POLL_S)

    # -- end of a motion ---------------------------------------------------------------------

    def _await_end(self, goal: Goal, sure: bool) -> None:
        began = silent_since = time.monotonic()
        progress = _Progress()
        while True:
            try:
                status = self.drive.read_status()
                if not sure:
                    self._recognise_attempt(goal, status)
                    sure = progress.was_lost = True
                if self._is_at_end(goal, status, progress):
                    return
            except LinkError:
                self._check_not_halted()
                sure = False
                if time.monotonic() - silent_since > self.limit_s("patience", PATIENCE_S):
                    raise
                time.sleep(POLL_S)
                continue
            silent_since = time.monotonic()
            if silent_since - began > goal.limit_s:
                raise DeviceError(
                    f"{self.name} has not arrived after {goal.limit_s:.0f} s.",
                    remedy="Look for what is in its way, then reset the module.",
                )
            time.sleep(POLL_S)

    def _recognise_attempt(self, goal: Goal, status: int) -> None:
        """Check that the state of the drive belongs to this attempt, if this is not sure (``_await_end``).
        Raises OutcomeUnknown if it does not, DeviceError after a fault or a stop."""
        state = state_of(status)
        if state in (State.FAULT, State.REACTING):
            raise self.drive.read_fault()
        self._check_not_halted()
        if state is not State.ENABLED:
            raise OutcomeUnknown(SWITCHED_OFF)
        mode = self.drive.read(profile.MODE_NOW, 1)
        if goal.homing:
            started = self.drive.read(profile.CONTROL, 2) & profile.START
            if mode != profile.HOMING or not started:
                raise OutcomeUnknown(NOT_THIS)
        elif mode != profile.PROFILE_POSITION or self.drive.read(profile.TARGET, 4) != goal.counts:
            raise OutcomeUnknown(NOT_THIS)

    def _is_at_end(self, goal: Goal, status: int, progress: _Progress) -> bool:
        """Whether the motion has ended with success. Raises DeviceError if it failed, OutcomeUnknown."""
        state = state_of(status)
        if state in (State.FAULT, State.REACTING):
            raise self.drive.read_fault()
        self._check_not_halted()
        if state is not State.ENABLED:
            raise DeviceError(
                f"{self.name}: the drive lost its power in mid-motion ({state.name}).",
                remedy="Check its supply and its enable input, then reset the module.",
            )
        return self._has_homed(status, progress) if goal.homing else self._has_arrived(goal, status, progress)

    def _has_homed(self, status: int, progress: _Progress) -> bool:
        if status & profile.FAILED:
            raise DeviceError(
                f"{self.name} has not found its home.", remedy="Check its switches, then reset the module."
            )
        # For a short time, the drive may still show the end of an earlier homing.
        progress.began = progress.began or not status & profile.ATTAINED or progress.age_s > BEGIN_S
        if not (progress.began and status & profile.ATTAINED and status & profile.REACHED):
            return False
        self._control(profile.ENABLE)
        self._refuse_mirrored_home()
        self._homed = True
        return True

    def _refuse_mirrored_home(self) -> None:
        """Check the sign with which the drive uses the home offset, because drives differ in it. Raises
        DeviceError if it is the opposite sign."""
        home = self.table.counts(self.table.home.position)
        window = abs(self.table.window * self.table.counts_per_unit)
        now = self.drive.read(profile.POSITION_NOW, 4)
        if abs(home) > window and abs(now + home) <= window:
            raise DeviceError(
                f"{self.name} says that its home is at {self.table.position(now):g} {self.table.unit}, and "
                f"should be at {self.table.home.position:g}: it takes the home offset the other way.",
                remedy="Change `offset_is_position` of its `home:`, and home it again.",
            )

    def _has_arrived(self, goal: Goal, status: int, progress: _Progress) -> bool:
        if not progress.taken:
            if status & profile.ACKNOWLEDGED:
                self._control(profile.ENABLE)
                progress.taken = True
            elif progress.was_lost and not self.drive.read(profile.CONTROL, 2) & profile.START:
                progress.taken = True  # or the start was lost: then it stands still elsewhere
            elif progress.age_s > self.limit_s("state", STATE_S):
                raise DeviceError(
                    f"{self.name}: the drive does not take the target.", remedy="Reset the module."
                )
            return False
        away = abs(self.drive.read(profile.POSITION_NOW, 4) - goal.counts)
        if away <= abs(self.table.window * self.table.counts_per_unit) and status & profile.REACHED:
            return True
        progress.stands = progress.stands + 1 if status & profile.REACHED else 0
        if progress.stands >= STANDS:
            if progress.was_lost:
                raise OutcomeUnknown(NEVER_BEGAN)
            raise DeviceError(
                f"{self.name} stands {away / abs(self.table.counts_per_unit):g} {self.table.unit} away from "
                "its target.",
                remedy="Look for what is in its way, then reset the module.",
            )
        return False

    # -- readings and commands ---------------------------------------------------------------

    def _is_moving(self) -> bool:
        status = self.drive.read_status()
        state = state_of(status)
        if state is State.REACTING:
            return True
        if state not in (State.ENABLED, State.QUICK_STOP):
            return False
        if status & profile.REACHED and self._is_reached_at_rest(state):
            return False
        # Before its first target, a drive may not report that the target is reached.
        before = self.drive.read(profile.POSITION_NOW, 4)
        time.sleep(POLL_S)
        way = abs(self.drive.read(profile.POSITION_NOW, 4) - before)
        return way > abs(self.table.window * self.table.counts_per_unit) / 10

    def _is_reached_at_rest(self, state: State) -> bool:
        mode = self.drive.read(profile.MODE_NOW, 1)
        return state is State.QUICK_STOP or mode in (profile.PROFILE_POSITION, profile.HOMING)

    def _is_homed(self, status: int) -> bool:
        if self.table.absolute:
            return True
        if self.table.homed_bit is not None:
            return bool(status >> self.table.homed_bit & 1)
        # After homing the motor keeps its power. If it has power now, the drive was not switched off since.
        return self._homed and state_of(status) is State.ENABLED

    def _read_position(self) -> float:
        """The position, in the axis' unit. If the axis stands at its target, this is the target itself,
        because the counts of an encoder always vary a little."""
        now = self.drive.read(profile.POSITION_NOW, 4)
        if self.drive.read(profile.MODE_NOW, 1) == profile.PROFILE_POSITION:
            target = self.drive.read(profile.TARGET, 4)
            if abs(now - target) <= abs(self.table.window * self.table.counts_per_unit):
                now = target
        return self.table.position(now)

    def _make_not_homed_error(self) -> DeviceError:
        return DeviceError(
            f"{self.name} does not know where it is.", effects="none", remedy="Home it: labos do."
        )

    def _check_not_halted(self) -> None:
        if self._halted.is_set():
            raise DeviceError(
                f"{self.name} was stopped in mid-motion.", remedy="Look at it, then reset the module."
            )

    def _control(self, word: int, *, anyway: bool = False) -> None:
        """Write the controlword. Raises DeviceError if the driver was stopped, because another word might end
        the quick stop. With ``anyway``, the word is written even then."""
        with self._commands:
            if not anyway:
                self.check_not_stopped()
            self.drive.write(profile.CONTROL, word, 2)

    @during_motion
    def _quick_stop(self) -> None:
        with self._commands:
            self.drive.write(profile.CONTROL, profile.QUICK_STOP, 2)


class _Progress:
    """The observations during a motion. ``taken``: the drive has taken the target. ``began``: the drive
    shows this homing, not an earlier one. ``was_lost``: ``sure`` was false at some time. ``stands``: how
    often in a row the drive stood still away from its target."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self.taken = self.began = self.was_lost = False
        self.stands = 0

    @property
    def age_s(self) -> float:
        return time.monotonic() - self._began_s
