"""Drives a PLC by its mapping.

A PLC continues an action by itself when the connection is lost. So a failed poll is repeated until the
deadline ``patience``. The values that are read afterwards count only if the PLC shows that they belong to
this attempt. It shows this by the number of the handshake, or by ``boot``: its program was not restarted
since it answered the start. A value that starts a motion is never written twice.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import Any, ClassVar
from zlib import crc32

import msgspec

from labos.errors import DeviceError, LinkError, NotConnected, OutcomeUnknown
from labos.node import Setup
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop
from labos_drivers.plc.mapping import Condition, MappedAction, PlcMapping, Variable, fill_argument
from labos_drivers.plc.points import Points, make_link
from labos_drivers.plc.values import PointValue, describe_condition, is_met, is_undecided

POLL_S = 0.1
PATIENCE_S = 30.0
"""For so long a PLC that does not answer is asked again in mid-action."""

BEGIN_S = 1.0
"""A PLC that has taken a start shows it within this time."""

TAKE_S = 5.0
"""After this long a number that the PLC does not show as taken has got lost."""

CYCLE_S = 0.5
"""Longer than one cycle of a PLC."""

RESET_S = 10.0
LONGER = 5.0
"""An action without a ``timeout`` may last so many times as long as its nominal duration."""

NOT_KEPT = "the connection was lost meanwhile, and the PLC does not distinguish this attempt from others"
RESTARTED = "the PLC was restarted meanwhile, and keeps no record of its actions"
NOT_TAKEN = "the PLC does not show that it has accepted this attempt"


class StartedAction(msgspec.Struct):
    """The journal's record of an attempt: its arguments, its ``number`` in the handshake, the value of the
    point ``boot`` before the start, and whether the PLC has answered the start (``taken``)."""

    args: dict[str, Any] = {}
    number: int = 0
    boot: PointValue | None = None
    taken: bool = False


class _Withdrawn(DeviceError):
    """The PLC has not accepted a number. The number was withdrawn and cannot be accepted later."""


class PlcDriver(Wired):
    """The driver of a PLC with this ``mapping``."""

    deadlines = ("patience", "take", "reset")
    where = ("address", "10.0.7.5")
    mapping: ClassVar[PlcMapping]

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._commands = threading.Lock()
        self.points = Points(make_link(address, setup.name, setup.config), self.mapping.points)

    @off_loop
    def connect(self) -> None:
        """Connect to the PLC and read all points once; nothing moves. Raises NotConnected, DeviceError."""
        self.points.link.open()
        self.points.read(self.mapping.points)

    def disconnect(self) -> None:
        self.points.link.close()

    # -- state -------------------------------------------------------------------------------

    @during_motion
    def is_idle(self) -> bool:
        seen = self.points.read({condition.point for condition in self.mapping.state.busy})
        return not self._is_busy(seen)

    def _is_busy(self, seen: dict[str, PointValue]) -> bool:
        """Whether the PLC is busy. An undecided condition counts as busy; without conditions it is idle."""
        values = ((condition, seen[condition.point]) for condition in self.mapping.state.busy)
        return any(is_met(condition, value) or is_undecided(condition, value) for condition, value in values)

    @during_motion
    def observe(self) -> dict[str, Any]:
        mapping = self.mapping
        sources = [*mapping.labware.values()]
        sources += [each for variable in mapping.variables.values() for each in variable.values.values()]
        points = {condition.point for conditions in sources for condition in conditions}
        seen = self.points.read(points | {each.point for each in mapping.variables.values() if each.point})
        observed: dict[str, Any] = {
            name: _read_variable(each, seen) for name, each in mapping.variables.items()
        }
        if mapping.labware:
            sure = {place: each for place, each in mapping.labware.items() if not _is_undecided(each, seen)}
            observed["labware"] = {place: _are_met(each, seen) for place, each in sure.items()}
        return observed

    @during_motion
    def read_levels(self) -> dict[str, float]:
        levels = self.points.read(self.mapping.resources.values())
        return {resource: float(levels[point]) for resource, point in self.mapping.resources.items()}

    @during_motion
    def trouble(self) -> str:
        """The error that the PLC reports; empty if there is none."""
        error = self._find_error(self.points.read(self._list_watched_points()))
        return str(error) if error is not None else ""

    @during_motion
    def read(self, action: MappedAction) -> Any:
        """The result of an action that only reads."""
        return self._read_result(action)

    # -- an action ---------------------------------------------------------------------------

    @off_loop
    def prepare(self, name: str, args: dict[str, Any], action_id: str) -> StartedAction:
        """Check that the action may start, and write the values of ``set``, which move nothing. Raises
        DeviceError (effects ``none``)."""
        self.check_not_stopped()
        action = self.mapping.actions[name]
        with self.report_no_effects():
            seen = self.points.read(self._list_watched_points(action))
            self._refuse_unless_fit(action, seen)
            self.points.write_all(action.set, args)
        return StartedAction(args, self._choose_number(action_id, seen), self._read_boot(seen))

    @off_loop
    def start(self, name: str, begun: StartedAction) -> bool:
        """Start the action with one write; returns whether the PLC has answered. Without a handshake, a
        missing answer raises LinkError. Raises DeviceError."""
        action, handshake = self.mapping.actions[name], self.mapping.handshake
        try:
            with self._commands:  # a stop comes before the start and prevents it, or is written after it
                self.check_not_stopped()
                if handshake is not None:
                    self.points.write(handshake.number, begun.number)
                elif action.start is not None:
                    self.points.write(action.start.point, fill_argument(action.start.value, begun.args))
        except NotConnected:
            raise
        except LinkError:
            if handshake is None:
                raise  # nothing in the PLC can show whether it received the start
            return False
        begun.taken = True
        return True

    @off_loop
    def await_end(self, name: str, begun: StartedAction, *, sure: bool) -> Any:
        """Wait for the end; returns the result. ``sure``: the PLC has answered the start, and the connection
        was not lost since then. Raises DeviceError, OutcomeUnknown."""
        try:
            with self.assume_motion():
                return self._await_end(name, self.mapping.actions[name], begun, sure=sure)
        except _Withdrawn as error:
            error.effects = "none"
            raise

    def _refuse_unless_fit(self, action: MappedAction, seen: dict[str, PointValue]) -> None:
        if (error := self._find_error(seen)) is not None:
            raise error
        if self._is_busy(seen):
            raise DeviceError(f"{self.name} is busy.", remedy="Wait until it is idle.")
        for condition in action.needs:
            value = seen[condition.point]
            if not is_met(condition, value):
                remedy = condition.remedy or "Correct this, then try again."
                raise DeviceError(f"{self.name}: {describe_condition(condition, value)}.", remedy=remedy)

    def _choose_number(self, action_id: str, seen: dict[str, PointValue]) -> int:
        """A number for this attempt, computed from the action's id. It is never 0, and is not the number that
        the PLC shows now. Without a handshake it is 0."""
        handshake = self.mapping.handshake
        if handshake is None:
            return 0
        limit = 0xFFFF if self.mapping.points[handshake.number].kind == "uint16" else 0xFFFFFFFF
        number = crc32(action_id.encode()) % limit + 1
        while number in (seen[handshake.taken], seen[handshake.number]):
            number = number % limit + 1
        return number

    def _read_boot(self, seen: dict[str, PointValue]) -> PointValue | None:
        return seen[self.mapping.boot] if self.mapping.boot else None

    # -- end of an action --------------------------------------------------------------------

    def _await_end(self, name: str, action: MappedAction, begun: StartedAction, *, sure: bool) -> Any:
        began = silent_since = time.monotonic()
        until = began + (action.timeout or LONGER * action.duration + self.limit_s("patience", PATIENCE_S))
        began_seen, handshake = False, self.mapping.handshake
        while True:
            try:
                seen = self.points.read(self._list_watched_points(action))
            except LinkError:
                self._check_not_halted(name)
                sure = False
                if time.monotonic() - silent_since > self.limit_s("patience", PATIENCE_S):
                    raise
                time.sleep(POLL_S)
                continue
            self._check_not_halted(name)  # after a stop, the values may be an effect of the stop
            silent_since = time.monotonic()
            sure = sure or self._is_this_attempt(seen, begun)
            if sure:
                self._raise_if_failed(name, action, seen)
                busy = self._is_busy(seen)
                began_seen = began_seen or busy or time.monotonic() - began > BEGIN_S
                if not busy and self._has_ended(action, begun, seen, began_seen):
                    return self._read_result(action)
            taken = handshake is None or seen[handshake.taken] == begun.number
            if not taken and time.monotonic() - began > self.limit_s("take", TAKE_S):
                self._withdraw(name, begun, seen)
            if time.monotonic() > until:
                waited = (
                    ", ".join(describe_condition(c, seen[c.point]) for c in action.done) or "it has not ended"
                )
                raise DeviceError(
                    f"{self.name}: {name} was started, but has not ended in time ({waited}).",
                    remedy="Check it, then reset the module.",
                )
            time.sleep(POLL_S)

    def _is_this_attempt(self, seen: dict[str, PointValue], begun: StartedAction) -> bool:
        """Whether the values belong to this attempt, after the connection was lost. Raises OutcomeUnknown if
        the PLC cannot show this, or was restarted."""
        handshake = self.mapping.handshake
        if handshake is not None:
            if begun.boot != self._read_boot(seen):
                raise OutcomeUnknown(RESTARTED)
            return seen[handshake.taken] == begun.number
        if begun.boot is None or not begun.taken:
            raise OutcomeUnknown(NOT_KEPT)
        if begun.boot != self._read_boot(seen):
            raise OutcomeUnknown(RESTARTED)
        return True

    def _withdraw(self, name: str, begun: StartedAction, seen: dict[str, PointValue]) -> None:
        """Withdraw a number that the PLC has not accepted, so that it cannot accept it later. Returns if the
        PLC has accepted it meanwhile. Raises DeviceError (effects ``none``) if it can no longer accept it.
        Raises OutcomeUnknown if the PLC does not hold the number, which may still arrive."""
        handshake = self.mapping.handshake
        if handshake is None or seen[handshake.number] != begun.number:
            raise OutcomeUnknown(NOT_TAKEN)
        self.points.write(handshake.number, seen[handshake.taken])
        time.sleep(CYCLE_S)  # in its present cycle, the PLC may still see the number
        if self.points.read([handshake.taken])[handshake.taken] != begun.number:
            raise _Withdrawn(
                f"{self.name} has not accepted {name}, which was withdrawn.",
                effects="none",
                remedy="Check whether it is in remote control (Modbus) or switched to local.",
            )

    def _has_ended(
        self, action: MappedAction, begun: StartedAction, seen: dict[str, PointValue], began: bool
    ) -> bool:
        handshake = self.mapping.handshake
        if handshake is not None:
            has_ended = (seen[handshake.taken], seen[handshake.done]) == (begun.number, begun.number)
        else:
            # For a short time, the PLC may still show its state from before the start.
            has_ended = began or not (action.done or self.mapping.state.busy)
        done = [_with_args(condition, begun.args) for condition in action.done]
        return has_ended and all(is_met(condition, seen[condition.point]) for condition in done)

    def _raise_if_failed(self, name: str, action: MappedAction, seen: dict[str, PointValue]) -> None:
        if (error := self._find_error(seen)) is not None:
            raise error
        for condition in action.failed:
            value = seen[condition.point]
            if is_met(condition, value):
                remedy = condition.remedy or "Check it, then reset the module."
                raise DeviceError(
                    f"{self.name}: {name} failed: {describe_condition(condition, value)}.", remedy=remedy
                )

    def _check_not_halted(self, name: str) -> None:
        if self._halted.is_set():
            raise DeviceError(
                f"{self.name} was stopped in mid-motion ({name}).",
                remedy="Check it, then reset the module.",
            )

    def _read_result(self, action: MappedAction) -> Any:
        if not action.result:
            return None
        values = self.points.read(action.result_points)
        if isinstance(action.result, dict):
            return {key: values[point] for key, point in action.result.items()}
        return values[action.result]

    # -- stop and reset ----------------------------------------------------------------------

    async def stop(self) -> None:
        self._halted.set()
        if not self.mapping.stop:
            await super().stop()
            return
        await self._write_stop()

    @during_motion
    def _write_stop(self) -> None:
        with self._commands:
            self.points.write_all(self.mapping.stop, {})

    @off_loop
    def reset(self) -> None:
        """Write the values of ``reset``, and wait until the PLC reports no error. Before that, withdraw a
        number that the PLC has not accepted, so that the reset starts no motion. Raises DeviceError if the
        PLC still reports an error at the deadline ``reset``."""
        handshake = self.mapping.handshake
        if handshake is not None:
            seen = self.points.read([handshake.number, handshake.taken])
            if seen[handshake.number] != seen[handshake.taken]:
                self.points.write(handshake.number, seen[handshake.taken])
                time.sleep(CYCLE_S)
        self.points.write_all(self.mapping.reset, {})
        time.sleep(CYCLE_S)  # before that, the PLC may not yet have seen a stop or the reset
        until = time.monotonic() + self.limit_s("reset", RESET_S)
        while (error := self._find_error(self.points.read(self._list_watched_points()))) is not None:
            if time.monotonic() > until:
                error.effects = "unknown"
                raise error
            time.sleep(POLL_S)
        self.resume()

    # -- values that were read ---------------------------------------------------------------

    def _list_watched_points(self, action: MappedAction | None = None) -> set[str]:
        """The points that show the state of the PLC, and that of the action if one is given."""
        state, handshake = self.mapping.state, self.mapping.handshake
        conditions = [*state.busy, *state.error]
        if action is not None:
            conditions += [*action.needs, *action.done, *action.failed]
        names = {condition.point for condition in conditions} | {state.why, self.mapping.boot}
        if handshake is not None:
            names |= {handshake.number, handshake.taken, handshake.done}
        return names - {""}

    def _find_error(self, seen: dict[str, PointValue]) -> DeviceError | None:
        """The error that the PLC reports, with its remedy; None if there is none."""
        state = self.mapping.state
        for condition in state.error:
            value = seen[condition.point]
            if not is_met(condition, value):
                continue
            why, remedy = describe_condition(condition, value), condition.remedy
            code = state.codes.get(f"{seen[state.why]:.0f}") if state.why and not condition.why else None
            if code is not None:
                why, remedy = f"{code.why} (fault {seen[state.why]:.0f})", code.remedy
            elif state.why and not condition.why:
                why = f"fault {seen[state.why]:.0f}"
            return DeviceError(f"{self.name}: {why}.", remedy=remedy or "Check it, then reset the module.")
        return None


def _are_met(conditions: Iterable[Condition], seen: dict[str, PointValue]) -> bool:
    return all(is_met(condition, seen[condition.point]) for condition in conditions)


def _is_undecided(conditions: Iterable[Condition], seen: dict[str, PointValue]) -> bool:
    return any(is_undecided(condition, seen[condition.point]) for condition in conditions)


def _read_variable(variable: Variable, seen: dict[str, PointValue]) -> Any:
    if variable.point:
        return seen[variable.point]
    values = (value for value, conditions in variable.values.items() if _are_met(conditions, seen))
    return next(values, variable.otherwise)


def _with_args(condition: Condition, args: dict[str, Any]) -> Condition:
    filled = {"is_": fill_argument(condition.is_, args), "near": fill_argument(condition.near, args)}
    return condition.model_copy(update=filled)
