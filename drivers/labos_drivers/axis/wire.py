"""A simulated CiA 402 drive on a CAN bus, behind an adapter on a serial port (slcan).

The node on the bus is that of the package canopen: SDO server, object dictionary, emergency messages. The
drive itself is simulated here: states, modes, motions in lab time, a spindle with a lower end for homing.
"""

from __future__ import annotations

import time
from typing import Any, ClassVar

from labos.link import FarEnd
from labos.link.wire import needs
from labos.node import Crash, Setup
from labos_drivers._onwire import OnLine
from labos_drivers.axis import profile
from labos_drivers.axis.profile import State
from labos_drivers.axis.table import STAGE, AxisTable

NODE = 1
REMOTE, VOLTAGE = 1 << 9, 1 << 4
FOLLOWING, OVERHEATED = 0x8611, 0x4310
LAGS_S = 2.0
"""In lab time: so long a blocked drive pushes before it gives up."""

INTEGERS = {1: (0x02, 0x05), 2: (0x03, 0x06), 4: (0x04, 0x07)}
"""CiA 301's types of signed and unsigned integers, by their bytes."""

OBJECTS: tuple[tuple[int, str, int, bool, str, int], ...] = (
    (profile.DEVICE_TYPE, "device type", 4, False, "ro", 0x0002_0000 | profile.PROFILE),
    (profile.ERROR_REGISTER, "error register", 1, False, "ro", 0),
    (0x1017, "producer heartbeat time", 2, False, "rw", 0),
    (profile.ERROR_CODE, "error code", 2, False, "ro", 0),
    (profile.CONTROL, "controlword", 2, False, "rw", 0),
    (profile.STATUS, "statusword", 2, False, "ro", 0),
    (profile.MODE, "modes of operation", 1, True, "rw", 0),
    (profile.MODE_NOW, "modes of operation display", 1, True, "ro", 0),
    (profile.POSITION_NOW, "position actual value", 4, True, "ro", 0),
    (profile.VELOCITY_NOW, "velocity actual value", 4, True, "ro", 0),
    (profile.POSITION_WINDOW, "position window", 4, False, "rw", 20),
    (profile.TARGET, "target position", 4, True, "rw", 0),
    (profile.HOME_OFFSET, "home offset", 4, True, "rw", 0),
    (profile.SPEED, "profile velocity", 4, False, "rw", 1000),
    (profile.ACCELERATION, "profile acceleration", 4, False, "rw", 10000),
    (profile.DECELERATION, "profile deceleration", 4, False, "rw", 10000),
    (profile.HOMING_METHOD, "homing method", 1, True, "rw", 0),
    (profile.HOMING_ACCELERATION, "homing acceleration", 4, False, "rw", 10000),
    (profile.SUPPORTED, "supported drive modes", 4, False, "ro", 0x21),
)
"""Index, name, bytes, whether signed, access, value at first."""


class DriveOnSlcan(OnLine):
    """The simulated drive. ``blocked``: an obstacle blocks the axis. ``hot``: the drive is too hot.
    ``no_switch``: homing does not find the switch. ``stands`` is the real position of the carriage when it
    does not move, in counts; the lower end is at the table's ``minimum``."""

    table: ClassVar[AxisTable] = STAGE
    line_end = b"\r"
    serial = 7001

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup, end)
        self.blocked = self.hot = self.no_switch = False
        self.state = State.DISABLED
        self.stands = float(self.table.counts(self.table.minimum + 40))
        self.homed = self.table.absolute
        self.error = 0
        self._origin = 0.0 if self.homed else self.stands  # the zero of its counts until it is homed
        self._mode = self._control = 0
        self._acknowledged = self._attained = self._failed = False
        self._reached = True
        self._goal: float | None = None
        self._from, self._since_s, self._takes_s = self.stands, 0.0, 1.0
        self._node: Any = None
        self._network: Any = None

    def power_on(self) -> None:
        """Switch adapter and drive on. The drive sends its boot-up message."""
        self._network, self._node = self._join_bus()
        self._network.send_message(0x700 + NODE, b"\0")

    # -- the bus -----------------------------------------------------------------------------

    def _join_bus(self) -> tuple[Any, Any]:
        try:
            import canopen
        except ImportError as error:
            raise needs("can", error) from error
        device = self

        class Network(canopen.Network):
            """canopen's network, with this adapter instead of an interface of python-can."""

            def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
                device.send(b"t%03X%d%s\r" % (can_id, len(data), bytes(data).hex().upper().encode()))

        network = Network()
        node: Any = network.create_node(NODE, _make_dictionary(canopen.objectdictionary))
        node.set_data(profile.LIMITS, profile.LOWEST, _encode(self.table.counts(self.table.minimum)))
        node.set_data(profile.LIMITS, profile.HIGHEST, _encode(self.table.counts(self.table.maximum)))
        node.set_data(profile.IDENTITY, 4, _encode(self.serial))
        node.add_read_callback(self._on_read)
        node.add_write_callback(self._on_write)
        return network, node

    def obey(self, line: str) -> None:
        """React to a line of slcan. ``t`` with identifier, length and bytes is a message. Other lines set up
        the adapter and are only confirmed."""
        if line.startswith("t") and self._network is not None:
            body = bytearray.fromhex(line[5 : 5 + 2 * int(line[4])])
            self._network.notify(int(line[1:4], 16), body, time.monotonic())
        elif line:
            self.send(b"\r")

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:
        """The present value of an object; None if its value is the one in the dictionary."""
        match index:
            case profile.STATUS:
                return self.compose_status()
            case profile.MODE_NOW:
                return self._mode
            case profile.POSITION_NOW:
                return round(self._find_position() - self._origin)
            case profile.VELOCITY_NOW:
                return 0 if self._goal is None else round((self._goal - self._from) / self._takes_s)
            case profile.ERROR_CODE:
                return self.error
            case profile.ERROR_REGISTER:
                return 0x01 if self.error else 0
        return None

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        value = int.from_bytes(data, "little", signed=True)
        match index:
            case profile.MODE:
                self._mode = value
            case profile.TARGET if self.homed:
                self._refuse_beyond_ends(value)
            case profile.CONTROL:
                self._obey(value & 0xFFFF)

    def _refuse_beyond_ends(self, counts: int) -> None:
        from canopen.sdo.exceptions import SdoAbortedError

        lowest, highest = (
            self._read_object(profile.LIMITS, end) for end in (profile.LOWEST, profile.HIGHEST)
        )
        if not lowest <= counts <= highest:
            raise SdoAbortedError(0x06090030)  # the value range is exceeded

    def _read_object(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self._node.get_data(index, subindex), "little", signed=True)

    # -- states ------------------------------------------------------------------------------

    def compose_status(self) -> int:
        """The present statusword."""
        word = self.state.value[1] | REMOTE
        if self.state not in (State.DISABLED, State.NOT_READY, State.FAULT):
            word |= VOLTAGE
        if self._reached:
            word |= profile.REACHED
        if self._mode == profile.HOMING:
            word |= profile.ATTAINED * self._attained | profile.FAILED * self._failed
        else:
            word |= profile.ACKNOWLEDGED * self._acknowledged
        if self.homed and self.table.homed_bit is not None:
            word |= 1 << self.table.homed_bit
        return word

    def _obey(self, word: int) -> None:
        before, self._control = self._control, word
        rises = word & ~before
        if self.state is State.FAULT:
            if rises & profile.RESET_FAULT and not self.hot:
                self.error, self.state = 0, State.DISABLED
            return
        self._change(word)
        if self.state is not State.ENABLED:
            return
        if rises & profile.START and self._mode == profile.PROFILE_POSITION:
            self._acknowledged = True
            self._move(
                self._read_object(profile.TARGET) + self._origin, self._read_object(profile.SPEED), "moves"
            )
        elif rises & profile.START and self._mode == profile.HOMING:
            self._home()
        if not word & profile.START:
            self._acknowledged = False
            if self._mode == profile.HOMING and self._goal is not None:
                self._halt()

    def _change(self, word: int) -> None:
        """Make the transitions that a controlword requests."""
        if not word & 0x02:
            self._halt()
            self.state = State.DISABLED
        elif not word & 0x04:
            if self.state is State.ENABLED:
                self._halt()
                self.state = State.QUICK_STOP
        elif word & 0x0F == profile.SHUT_DOWN and self.state is not State.QUICK_STOP:
            self._halt()
            self.state = State.READY
        elif word & 0x0F == profile.SWITCH_ON and self.state in (State.READY, State.ENABLED):
            self._halt()
            self.state = State.SWITCHED_ON
        elif word & 0x0F == profile.ENABLE and self.state in (State.SWITCHED_ON, State.QUICK_STOP):
            self.state = State.ENABLED

    def fail(self, code: int) -> None:
        """Stop the drive, and report a fault with this error code."""
        self._halt()
        self.state, self.error = State.FAULT, code
        if self._node is not None:
            self._node.emcy.send(code, 0x01)

    def damage(self, crash: Crash) -> None:
        self.fail(FOLLOWING)

    # -- motions -----------------------------------------------------------------------------

    def _find_position(self) -> float:
        if self._goal is None:
            return self.stands
        share = min((self.now_s() - self._since_s) / self._takes_s, 1.0)
        return self._from + (self._goal - self._from) * (0.01 * share if self.blocked else share)

    def _halt(self) -> None:
        self.stands, self._goal = self._find_position(), None
        self._reached = True
        self.forget_plans()

    def _move(self, goal: float, counts_per_s: int, verb: str) -> None:
        self._halt()
        self._from, self._goal, self._since_s = self.stands, goal, self.now_s()
        way = abs(goal - self.stands)
        self._takes_s = way / counts_per_s + counts_per_s / self._read_object(profile.ACCELERATION) + 1e-3
        self._reached = False
        self.world.work(self.name, verb)
        if self.hot:
            self.after(LAGS_S, lambda: self.fail(OVERHEATED))
        elif self.blocked:
            self.after(LAGS_S, lambda: self.fail(FOLLOWING))
        else:
            self.after(self._takes_s, lambda: self._arrive(goal), exact=True)

    def _arrive(self, goal: float) -> None:
        self.stands, self._goal = goal, None
        if self._mode == profile.HOMING:
            if self.no_switch:
                self._failed = self._reached = True
                return
            # In the profile, the home offset is the distance from the home to zero.
            self._origin = goal + self._read_object(profile.HOME_OFFSET)
            self.homed = self._attained = True
        where = self.table.position(self.stands - self._origin)
        self.world.work(self.name, f"stands at {where:g}")
        self._reached = True

    def _home(self) -> None:
        """Move to the switch at the lower end."""
        self._attained = self._failed = self.homed = False
        speed = self._read_object(profile.HOMING_SPEEDS, profile.SWITCH_SPEED)
        self._move(float(self.table.counts(self.table.minimum)), speed, "homes")


def _make_dictionary(od: Any) -> Any:
    """The drive's object dictionary."""
    found = od.ObjectDictionary()
    for index, name, size, signed, access, value in OBJECTS:
        found.add_object(_make_variable(od, index, 0, name, size, signed, access, value))
    for index, name, signed, first, second in (
        (profile.LIMITS, "software position limit", True, "lowest", "highest"),
        (profile.HOMING_SPEEDS, "homing speeds", False, "to the switch", "to zero"),
    ):
        record = od.ODRecord(name, index)
        record.add_member(_make_variable(od, index, 0, "highest subindex", 1, False, "ro", 2))
        for subindex, member in ((1, first), (2, second)):
            record.add_member(_make_variable(od, index, subindex, member, 4, signed, "rw", 0))
        found.add_object(record)
    identity = od.ODRecord("identity object", profile.IDENTITY)
    identity.add_member(_make_variable(od, profile.IDENTITY, 0, "highest subindex", 1, False, "ro", 4))
    for subindex, member in enumerate(("vendor", "product code", "revision", "serial number"), 1):
        identity.add_member(_make_variable(od, profile.IDENTITY, subindex, member, 4, False, "ro", 0))
    found.add_object(identity)
    return found


def _make_variable(
    od: Any, index: int, subindex: int, name: str, size: int, signed: bool, access: str, value: int
) -> Any:
    variable = od.ODVariable(name, index, subindex)
    variable.data_type = INTEGERS[size][0 if signed else 1]
    variable.access_type, variable.default = access, value
    return variable


def _encode(value: int) -> bytes:
    return value.to_bytes(4, "little", signed=True)
