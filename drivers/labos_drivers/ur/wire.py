"""A simulated UR controller: its dashboard, the port of its gripper, and the port of its real-time data.

Its programs are those under ``programs`` and ``pendant`` of its configuration. A program with a source and a
target carries the labware that is at the source. Those under ``pendant`` do the actions of the pendant drop.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sin
from typing import Any

from labos.link import FarEnd, TcpEnd
from labos.node import Crash, Setup
from labos_drivers._arm import Arm
from labos_drivers._onwire import OnLine
from labos_drivers.ur import protocol, rtde
from labos_drivers.ur.rig import Rig
from labos_drivers.ur.rtde_wire import RtdePort

POWER_S, BRAKES_S, RESTART_S = 8.0, 6.0, 5.0
NEW_WITH_E_SERIES = ("is in remote control", "safetystatus")
"""What the dashboard of a CB3 does not know."""
GRIP_AT, RELEASE_AT = 0.3, 0.75
"""Of a program that carries something, when its fingers close and open."""
HOME, TURN_RAD = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0), 1.2
OUTPUTS = dict(zip(rtde.RECIPE, rtde.TYPES, strict=True)) | {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "robot_status_bits": "UINT32",
}
RUNTIME = {protocol.STOPPED: rtde.STOPPED, protocol.PLAYING: rtde.PLAYING, protocol.PAUSED: rtde.PAUSED}


class UROnWire(OnLine):
    """The state and the behaviour of the device. ``started``: it has power, and its brakes are released.
    ``stopped_by_hand``: a person stops each program on the pendant. ``fingers_move``: its gripper reports
    that its fingers move."""

    serial = "20205300001"

    def __init__(
        self, setup: Setup, end: FarEnd | None = None, *, started: bool = True, data: TcpEnd | None = None
    ) -> None:
        super().__init__(setup, end)
        self.fingers = TcpEnd()
        self.data = RtdePort(self._outputs, OUTPUTS, data)
        self.mode = protocol.RUNNING if started else protocol.OFF
        self.safety = protocol.NORMAL
        self.state = protocol.STOPPED
        self.remote = True
        self.is_cb3 = False
        self.stopped_by_hand = self.fingers_move = False
        self.loaded = ""
        self.programs: dict[str, dict[str, Any]] = {
            str(entry["program"]): entry for entry in setup.config.get("programs") or ()
        }
        self.inputs: set[int] = set()
        self._began_s = self._stopped_s = 0.0
        self.rig = Rig(self.world, self.name)
        self._pendant = setup.config.get("pendant") or {}
        for action, configured in self._pendant.items():
            entries = [{"program": configured}] if isinstance(configured, str) else configured
            for entry in entries if isinstance(entries, list) else ():
                self.programs[entry["program"]] = {**entry, "does": action}
        self._asked = b""

    @property
    def address(self) -> str:
        return f"{self.end.address},{self.fingers.address},{self.data.end.address}"

    def make_end(self) -> FarEnd:
        return TcpEnd(greeting=protocol.GREETING + protocol.END)

    def close(self) -> None:
        super().close()
        self.fingers.close()
        self.data.close()

    # -- receiving ---------------------------------------------------------------------------

    def listen(self, timeout_s: float) -> None:
        super().listen(min(timeout_s, 0.002))
        self.data.listen(0.002)
        self._asked += self.fingers.read(0.002)
        while b"\n" in self._asked:
            line, _, self._asked = self._asked.partition(b"\n")
            if line.strip() == b"GET OBJ":
                held = bool(self.find_held_plate())
                seen = protocol.HELD_CLOSING if held else protocol.EMPTY
                self.fingers.write(b"OBJ %d\n" % (protocol.MOVING if self.fingers_move else seen))

    def obey(self, line: str) -> None:
        self.send(self._answer(line).encode() + protocol.END)

    def _answer(self, line: str) -> str:
        answers: dict[str, Callable[[], str]] = {
            "robotmode": lambda: f"Robotmode: {self.mode}",
            "safetystatus": lambda: f"Safetystatus: {self.safety}",
            "programState": lambda: f"{self.state} {self.loaded or '<unnamed>'}",
            "running": lambda: f"Program running: {str(self.state == protocol.PLAYING).lower()}",
            "is in remote control": lambda: str(self.remote).lower(),
            "get loaded program": lambda: (
                f"Loaded program: {self.loaded}" if self.loaded else "No program loaded"
            ),
            "PolyscopeVersion": lambda: "URSoftware 5.12.2.1101534 (Jul 06 2022)",
            "get robot model": lambda: "UR5",
            "get serial number": lambda: self.serial,
            "quit": lambda: "Disconnected",
        }
        orders: dict[str, Callable[[], str]] = {
            "power on": self._power_on,
            "power off": self._power_off,
            "brake release": self._release_brakes,
            "play": self._play,
            "stop": self._stop_program,
            "pause": self._pause_program,
            "unlock protective stop": self._unlock,
            "close safety popup": lambda: "closing safety popup",
            "restart safety": self._restart_safety,
        }
        if self.is_cb3 and line in NEW_WITH_E_SERIES:
            return f"could not understand: '{line}'"
        if self.is_cb3 and line == "safetymode":
            return f"Safetymode: {self.safety}"
        if line in answers:
            return answers[line]()
        if line in orders or line.startswith("load "):
            if not self.remote:
                return f"Command is not allowed due to safety reasons: {line}"
            return orders[line]() if line in orders else self._load(line.removeprefix("load ").strip())
        return f"could not understand: {line}"

    # -- carrying commands out ---------------------------------------------------------------

    def _power_on(self) -> str:
        self.after(POWER_S, lambda: self._become(protocol.IDLE, before=protocol.OFF))
        return "Powering on"

    def _power_off(self) -> str:
        self._freeze(protocol.STOPPED)
        self.mode = protocol.OFF
        return "Powering off"

    def _release_brakes(self) -> str:
        """Release the brakes; if the power is off, this also switches it on."""
        first_s = POWER_S if self.mode == protocol.OFF else 0.0
        self.after(first_s + BRAKES_S, lambda: self._become(protocol.RUNNING))
        return "Brake releasing"

    def _become(self, mode: str, before: str = "") -> None:
        if before in ("", self.mode):
            self.mode = mode

    def _load(self, name: str) -> str:
        if name not in self.programs:
            return f"File not found: {name}"
        self.loaded = name
        return f"Loading program: {name}"

    def _play(self) -> str:
        fit = self.mode == protocol.RUNNING and self.safety == protocol.NORMAL
        if not (fit and self.loaded and self.state == protocol.STOPPED):
            return "Failed to execute: play"
        self.state, self._began_s = protocol.PLAYING, self.now_s()
        self.world.enter(self.name, self.name)
        entry, usual_s = self.programs[self.loaded], Arm.transfer_s * 1.5
        source, target = str(entry.get("source", "")), str(entry.get("target", ""))
        if self.stopped_by_hand:
            self.after(0.5 * GRIP_AT * usual_s, lambda: self._freeze(protocol.STOPPED))
        if source and self.place(source) != self.place("gripper"):
            self.after(GRIP_AT * usual_s, lambda: self._grip(self.place(source)))
        if target and self.place(target) != self.place("gripper"):
            self.after(RELEASE_AT * usual_s, lambda: self._release(self.place(target)))
        if "does" in entry:
            self.after(0.5 * usual_s, lambda: self._do(entry))
        self.after(usual_s, lambda: self._end(entry))
        return "Starting program"

    def _grip(self, place: str) -> None:
        self.world.enter(self.name, place)
        if self.world.at(place):
            self.world.grip(self.name, place)

    def _release(self, place: str) -> None:
        self.world.enter(self.name, place)
        if self.find_held_plate():
            self.open_hand(place)

    def _do(self, entry: dict[str, Any]) -> None:
        plate = self.place(entry["plate"]) if "plate" in entry else ""
        if plate:
            self.world.enter(self.name, plate)
        facts = {"tool": entry.get("tool", "")} if entry["does"] == "undock" else {}
        self.rig.do(entry["does"], plate, **facts)

    def _end(self, entry: dict[str, Any]) -> None:
        if not any(entry.get(key) for key in ("source", "target", "does")):
            self.world.work(self.name, "program", program=self.loaded)
        self.state = protocol.STOPPED
        self.world.leave(self.name)

    def _stop_program(self) -> str:
        if self.state == protocol.STOPPED:
            return "Failed to execute: stop"
        self._freeze(protocol.STOPPED)
        return "Stopped"

    def _pause_program(self) -> str:
        if self.state != protocol.PLAYING:
            return "Failed to execute: pause"
        self._freeze(protocol.PAUSED)
        return "Pausing program"

    def _freeze(self, state: str) -> None:
        self.forget_plans()
        self.state = state

    def _restart_safety(self) -> str:
        def finish_restart() -> None:
            if self.safety in protocol.FAULTS:
                self.safety = protocol.NORMAL

        self._freeze(protocol.STOPPED)
        self.mode = protocol.OFF
        self.after(RESTART_S, finish_restart)
        return "Restarting safety"

    def _unlock(self) -> str:
        self.safety = protocol.NORMAL
        return "Protective stop releasing"

    def _outputs(self) -> dict[str, Any]:
        """The present values of the real-time data. While a program plays, the base turns back and forth."""
        moves = self.state == protocol.PLAYING
        if moves:
            self._stopped_s = self.now_s()
        angle = self._stopped_s - self._began_s
        return {
            "timestamp": self.now_s(),
            "actual_q": (TURN_RAD * sin(angle), *HOME[1:]),
            "actual_qd": (TURN_RAD if moves else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            "robot_mode": rtde.MODES[self.mode],
            "safety_mode": rtde.SAFETY[self.safety],
            "runtime_state": RUNTIME[self.state],
            "actual_digital_input_bits": sum(1 << number for number in self.inputs | self._sensors()),
            "robot_status_bits": (self.mode != protocol.OFF) | moves << 1,
        }

    def _sensors(self) -> set[int]:
        """The digital inputs that the sensors of dock, pipette and tip switch on."""
        return {int(self._pendant[key]) for key in self.rig.list_inputs() if key in self._pendant}

    def press_stop(self) -> None:
        """A person presses the emergency stop."""
        self._freeze(protocol.STOPPED)
        self.safety, self.mode = "ROBOT_EMERGENCY_STOP", protocol.OFF

    def damage(self, crash: Crash) -> None:
        self._freeze(protocol.PAUSED)
        self.safety = protocol.PROTECTIVE
