"""Drives a PLC by its mapping.

A PLC goes on by itself when the connection is lost. So a poll that fails is asked again for a while, and
what is seen afterwards is believed only if the PLC shows that it is the attempt that was begun: by the
number of the handshake, or because its program was not started anew (``boot``) since it took the start.
Nothing that moves is ever written twice.
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
    """What the journal keeps of an attempt: its arguments, its ``number`` in the handshake, when the PLC's
    program was started (``boot``), whether the start was ``taken``."""

    args: dict[str, Any] = {}
    number: int = 0
    boot: PointValue | None = None
    taken: bool = False


class _Withdrawn(DeviceError):
    """The PLC has not taken a number, and never will."""


class PlcDriver(Wired):
    """Commands of a PLC with this ``mapping``."""

    deadlines = ("patience", "take", "reset")
    where = ("address", "10.0.7.5")
    mapping: ClassVar[PlcMapping]

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._commands = threading.Lock()
        self.points = Points(make_link(address, setup.name, setup.config), self.mapping.points)

    @off_loop
    def connect(self) -> None:
        """Find the PLC, and all points in it; nothing moves. Raises NotConnected, DeviceError."""
        self.points.link.open()
        self.points.read(self.mapping.points)

    def disconnect(self) -> None:
        self.points.link.close()

    # -- how it is ---------------------------------------------------------------------------

    @during_motion
    def is_idle(self) -> bool:
        seen = self.points.read({condition.point for condition in self.mapping.state.busy})
        return not self._is_busy(seen)

    def _is_busy(self, seen: dict[str, PointValue]) -> bool:
        """Whether the PLC is busy; it is, unless it says that it is not."""
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
        """Check that the action may begin, and write what moves nothing. Raises DeviceError (``none``)."""
        self.check_not_stopped()
        action = self.mapping.actions[name]
        with self.report_no_effects():
            seen = self.points.read(self._list_watched_points(action))
            self._refuse_unless_fit(action, seen)
            self.points.write_all(action.set, args)
        return StartedAction(args, self._choose_number(action_id, seen), self._read_boot(seen))

    @off_loop
    def start(self, name: str, begun: StartedAction) -> bool:
        """Start it, with one write; returns whether the PLC has answered. Raises DeviceError."""
        action, handshake = self.mapping.actions[name], self.mapping.handshake
        try:
            with self._commands:  # a stop comes before the start, and then there is none, or after it
                self.check_not_stopped()
                if handshake is not None:
                    self.points.write(handshake.number, begun.number)
                elif action.start is not None:
                    self.points.write(action.start.point, fill_argument(action.start.value, begun.args))
        except NotConnected:
            raise
        except LinkError:
            if handshake is None:
                raise  # whether it was heard, nothing in the PLC can tell
            return False
        begun.taken = True
        return True

    @off_loop
    def await_end(self, name: str, begun: StartedAction, *, sure: bool) -> Any:
        """Wait for the end; returns the result. ``sure``: the PLC has answered the start, and the connection
        was not lost since. Raises DeviceError, OutcomeUnknown."""
        try:
            with self.under_way():
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
        """A number for this attempt that is not the one before, and never 0."""
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

    # -- its end -----------------------------------------------------------------------------

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
            self._check_not_halted(name)  # what is seen now may be what the stop did
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
        """Whether the PLC shows this attempt, after the connection was lost. Raises OutcomeUnknown."""
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
        """A number that the PLC has not taken must not be taken later. Returns if it was taken after all.
        Raises DeviceError (``none``) if it never will be, OutcomeUnknown if it may still be on its way."""
        handshake = self.mapping.handshake
        if handshake is None or seen[handshake.number] != begun.number:
            raise OutcomeUnknown(NOT_TAKEN)
        self.points.write(handshake.number, seen[handshake.taken])
        time.sleep(CYCLE_S)  # in the cycle that runs, the PLC may still see the number
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
            # The PLC may show for a moment what was before it took the start.
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

    # -- stopping and recovering -------------------------------------------------------------

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
        """Write what brings the PLC out of an error, and check that it is. A number that it has not taken is
        withdrawn before, so that nothing begins to move by that."""
        handshake = self.mapping.handshake
        if handshake is not None:
            seen = self.points.read([handshake.number, handshake.taken])
            if seen[handshake.number] != seen[handshake.taken]:
                self.points.write(handshake.number, seen[handshake.taken])
                time.sleep(CYCLE_S)
        self.points.write_all(self.mapping.reset, {})
        time.sleep(CYCLE_S)  # before that, neither a stop nor the reset need have been seen
        until = time.monotonic() + self.limit_s("reset", RESET_S)
        while (error := self._find_error(self.points.read(self._list_watched_points()))) is not None:
            if time.monotonic() > until:
                error.effects = "unknown"
                raise error
            time.sleep(POLL_S)
        self.resume()

    # -- what is seen ------------------------------------------------------------------------

    def _list_watched_points(self, action: MappedAction | None = None) -> set[str]:
        """The points that show the state of an action."""
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
