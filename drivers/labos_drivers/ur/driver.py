"""The driver of a UR arm. It runs programs that are stored in the controller, over the dashboard. Their
progress and end are read from the controller's real-time data, if ``rtde`` is not false."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from labos.errors import Collision, DeviceError, Garbled
from labos.link import Link, TcpWire, Terminated
from labos.node import Setup
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop, parse_host_port
from labos_drivers.ur import programs, protocol, rtde
from labos_drivers.ur.stream import Stream

ANSWER_S, LOAD_S, BEGIN_S, PROGRAM_S, POWER_S = 5.0, 30.0, 5.0, 1800.0, 60.0
FINGERS_S = 5.0
"""So long fingers that move are waited for, before and after a program."""

POLL_S = 0.2
WHO = "a UR dashboard"
PENDANT: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "pick_pipette": ({"tool": ""}, {"tool": "pipette"}),
    "place_pipette": ({"tool": "pipette"}, {"tool": ""}),
    "dock": ({"docked": False}, {"docked": True}),
    "undock": ({"docked": True}, {"docked": False}),
    "create_sample": ({"tool": "pipette", "tip": ""}, {"tip": "sample"}),
    "run_droplet": ({"tool": "", "tip": "sample"}, {}),
    "dispose_tip": ({"tool": "pipette", "tip": "sample"}, {"tip": ""}),
}
"""What the arm's inputs have to tell before each action of the pendant drop, and what has changed then."""


class URDriver(Wired):
    """Commands of the arm. Its motions are programs that were taught on the controller. The workcell file
    names the program for each action, with its source and target or its other arguments."""

    deadlines = ("answer", "load", "begin", "program", "power", "fingers")
    where = ("host", "192.168.0.40")
    link: Link
    _gripper: Link | None = None
    _gripper_input: int | None = None
    _stream: Stream | None = None

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        dashboard, gripper, data = [*address.split(","), "", ""][:3]
        host, port = parse_host_port(dashboard, protocol.DASHBOARD)
        self.link = Link(
            TcpWire(host, port),
            Terminated(protocol.END),
            name=setup.name,
            identify=self._recognise,
            expected=WHO,
        )
        if setup.config.get("rtde", True):
            self._stream = Stream(*parse_host_port(data or host, rtde.PORT), setup.name)
        configured = setup.config.get("gripper")
        if configured == "robotiq":
            at = parse_host_port(gripper or host, protocol.GRIPPER)
            self._gripper = Link(TcpWire(*at), Terminated(protocol.END), name=f"{setup.name} gripper")
        elif isinstance(configured, dict):
            self._gripper_input = programs.read_input(setup, configured, "input", "gripper")
        pendant = setup.config.get("pendant") or {}
        self._wired = {
            variable: (programs.read_input(setup, pendant, key, "pendant"), on, off)
            for variable, (key, on, off) in protocol.SENSORS.items()
            if key in pendant
        }

    @off_loop
    def connect(self) -> None:
        """Connect to dashboard and real-time data; nothing moves. Raises NotConnected, WrongDevice."""
        self.link.open()
        if self._stream is not None:
            self._stream.link.open()

    def disconnect(self) -> None:
        super().disconnect()
        for line in (self._gripper, self._stream):
            if line is not None:
                line.close()

    # -- programs ----------------------------------------------------------------------------

    @off_loop
    def transfer(self, source: str, target: str, program: str = "") -> None:
        """Carry labware with the program for this source and target; ``program`` names it if the workcell
        file does not. Raises DeviceError."""
        with self.motion():
            named = programs.find_carrying_program(self._setup, source, target, program)
            self._check_hand(full=False)
            held = self._run(named)
            if not held and self._has_gripper_sensor:
                raise DeviceError(
                    f"{self.name}: the gripper was not seen to hold anything in {named}.",
                    remedy=f"Look whether the labware stands at {source} still.",
                )
            self._check_hand_after(held=False, after=f"the transfer to {target}")

    @off_loop
    def pick(self, source: str) -> None:
        with self.motion():
            program = programs.find_carrying_program(self._setup, source, "gripper")
            self._check_hand(full=False)
            self._run(program)
            self._check_hand_after(held=True, after=f"picking at {source}")

    @off_loop
    def put_down(self, target: str) -> None:
        with self.motion():
            program = programs.find_carrying_program(self._setup, "gripper", target)
            self._check_hand(full=True)
            self._run(program)
            self._check_hand_after(held=False, after=f"putting down at {target}")

    @off_loop
    def run_program(self, program: str) -> None:
        with self.motion():
            self._run(programs.check_program(self.name, program))

    @off_loop
    def pendant(self, action: str, /, **args: str) -> None:
        """Carry out an action of the pendant drop with its program. Raises DeviceError."""
        with self.motion():
            program = programs.find_pendant_program(self._setup, action, args)
            before, after = PENDANT[action]
            if action == "undock":
                after = {**after, "tool": args["tool"]}
            with self.report_no_effects():
                self._check_sensors(before, f"{action} needs")
            self._run(program)
            with self.assume_motion():
                self._check_sensors(after, f"after {action} it should be")

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """End a stop, switch the arm's power on and release its brakes. A program in progress is stopped, and
        none is started: nothing but the brakes moves. Raises DeviceError."""
        self.resume()
        self.disconnect()  # so that all links connect again: it may have been switched off
        self._read_hand()
        self._check_remote()
        safety = self._read_safety()
        if safety == protocol.PROTECTIVE:
            self._order("unlock protective stop", "Protective stop releasing")
        elif safety in protocol.FAULTS:
            self._order("close safety popup", "closing safety popup")
            self._order("restart safety", "Restarting safety", "true")
            self._await_status("safety status", self._read_safety, protocol.NORMAL, protocol.REDUCED)
        elif safety not in (protocol.NORMAL, protocol.REDUCED):
            raise self.make_refusal(
                f"its safety status is {safety}", "Release the emergency stop, then reset the module."
            )
        if self._read_state() != protocol.STOPPED:
            self._order("stop", "Stopped")
        if self._read_mode() != protocol.RUNNING:
            self._order("power on", "Powering on")
            self._await_status("robotmode", self._read_mode, protocol.IDLE, protocol.RUNNING)
            self._order("brake release", "Brake releasing")
            self._await_status("robotmode", self._read_mode, protocol.RUNNING)

    @during_motion
    def stop(self) -> None:
        """Stop the program; the arm stops where it is. Raises DeviceError."""
        self._halted.set()
        if self._read_state() != protocol.STOPPED:
            self._order("stop", "Stopped")

    @during_motion
    def is_idle(self) -> bool:
        return self._read_state() == protocol.STOPPED and (
            self._stream is None or self._stream.read_state().stands_still
        )

    @during_motion
    def observe(self) -> dict[str, Any]:
        """Whether the gripper holds something; left out if its fingers move or no gripper reports it. Also
        the states of dock, pipette and tip, if their sensors are wired to inputs. Raises DeviceError."""
        held = self._read_hand()
        return self._read_sensors() | ({} if held is None else {"labware": {"gripper": held}})

    # -- one program -------------------------------------------------------------------------

    def _run(self, program: str) -> bool | None:
        """Run a program, and wait for its end. Returns whether the gripper held something meanwhile; None if
        not known. Raises DeviceError. A program that a person stops on the pendant counts as ended."""
        with ExitStack() as end:
            with self.report_no_effects():
                self._refuse_unless_ready()
                self._order(f"load {program}", "Loading program", limit_s=self.limit_s("load", LOAD_S))
                self.check_not_stopped()
                states = end.enter_context(self._watch_program())
            self._play(program)
            with self.assume_motion():
                held = self._await_end(program, states)
                self._refuse_unless_safe(program)
                self.check_not_stopped()
        return held

    def _await_end(self, program: str, states: Iterator[str]) -> bool | None:
        """Wait for the end of a program, and with real-time data until the arm stands still. Returns whether
        the gripper held something, as ``_run``. Raises DeviceError."""
        began, limit_s = time.monotonic(), self.limit_s("program", PROGRAM_S)
        played = False
        held = None
        for state in states:
            played = played or state == protocol.PLAYING
            if state == protocol.STOPPED and (played or self._halted.is_set()):
                break
            if (holds := self._read_hand()) is not None:
                held = held or holds
            passed_s = time.monotonic() - began
            if not played and passed_s > self.limit_s("begin", BEGIN_S):
                raise DeviceError(
                    f"{self.name}: {program} was started, but was not seen to run.",
                    remedy="Look at the arm, then reset the module.",
                )
            if state == protocol.PAUSED:
                self._refuse_unless_safe(program)
            if passed_s > limit_s:
                raise DeviceError(f"{self.name}: {program} has not ended within {limit_s:g} s.")
        return held

    @contextmanager
    def _watch_program(self) -> Iterator[Iterator[str]]:
        """The states of the program from now on. They come from the real-time data, so that none is missed;
        without these, the dashboard is asked. The state of a stopped program is empty while the arm moves."""
        if self._stream is None:
            yield self._poll_states()
            return
        with self._stream.watch() as robots:
            yield (_find_state(robot) for robot in robots)

    def _poll_states(self) -> Iterator[str]:
        while True:
            yield self._read_state()
            time.sleep(POLL_S)

    def _play(self, program: str) -> None:
        """Start the program. Raises DeviceError after a known refusal: it does not run. Raises Garbled after
        another answer: it may run."""
        answer = self._ask("play")
        if answer.startswith("Starting program"):
            return
        if answer.startswith(protocol.REFUSALS):
            raise DeviceError(
                f"{self.name}: the controller refuses to play {program}: {answer}",
                effects="none",
                remedy="Look at the pendant.",
            )
        raise Garbled(f"{self.name}: {answer!r} does not say whether {program} runs.")

    def _refuse_unless_safe(self, program: str) -> None:
        safety = self._read_safety()
        if safety not in (protocol.NORMAL, protocol.REDUCED):
            kind = Collision if safety == protocol.PROTECTIVE else DeviceError
            raise kind(
                f"{self.name}: {safety} in {program}.",
                remedy="Look at the arm and at what it holds, then reset the module.",
            )

    def _refuse_unless_ready(self) -> None:
        """Raise DeviceError if the controller is not ready for a program."""
        self._check_remote()
        for what, ask, wanted in (
            ("safetystatus", self._read_safety, (protocol.NORMAL, protocol.REDUCED)),
            ("robotmode", self._read_mode, (protocol.RUNNING,)),
        ):
            if (answer := ask()) not in wanted:
                raise DeviceError(f"{self.name}: its {what} is {answer}.", remedy="Reset the module.")
        if (state := self._read_state()) != protocol.STOPPED:
            raise DeviceError(f"{self.name}: a program is {state}.", remedy="Wait, or reset the module.")

    def _check_remote(self) -> None:
        answer = self._ask("is in remote control")
        if _is_not_understood(answer):
            return  # a CB3 (no local mode) or software before 5.6; it refuses forbidden commands itself
        if answer != "true":
            raise self.make_refusal(
                "the controller is not in remote control", "Switch it to remote control on the pendant."
            )

    def _read_sensors(self) -> dict[str, Any]:
        if self._stream is None or not self._wired:
            return {}
        now = self._stream.read_state()
        inputs = self._wired.items()
        return {name: on if now.input(number) else off for name, (number, on, off) in inputs}

    def _check_sensors(self, wanted: Mapping[str, Any], why: str) -> None:
        """Raise DeviceError if a wired input shows another value than the wanted one."""
        for variable, seen in self._read_sensors().items():
            if seen != wanted.get(variable, seen):
                is_now, needed = _describe_value(seen), _describe_value(wanted[variable])
                raise DeviceError(
                    f"{self.name}: its {variable} is {is_now}; {why} {needed}.",
                    remedy="Look at the arm and at the dock.",
                )

    def _check_hand(self, *, full: bool) -> None:
        with self.report_no_effects():
            self._check_sensors({"tool": ""}, "its gripper needs")
            if self._read_hand_at_rest() is (not full):
                raise DeviceError(f"{self.name}: its hand is {'empty' if full else 'full'}.")

    def _check_hand_after(self, *, held: bool, after: str) -> None:
        """Check what the gripper holds after a motion. If it does not answer, the effects are unknown. Raises
        DeviceError."""
        with self.assume_motion():
            if self._read_hand_at_rest() is (not held):
                raise DeviceError(
                    f"{self.name}: after {after} the gripper holds {'nothing' if held else 'something'}.",
                    remedy="Look where the labware is.",
                )

    @property
    def _has_gripper_sensor(self) -> bool:
        """Whether there is a gripper that reports what it holds."""
        return self._gripper is not None or (self._gripper_input is not None and self._stream is not None)

    def _read_hand_at_rest(self) -> bool | None:
        """Wait until the gripper's fingers stand still. Returns whether it holds something; None if no
        gripper reports it. Raises DeviceError if they still move after the limit: then it is not known."""
        limit_s = self.limit_s("fingers", FINGERS_S)
        deadline = time.monotonic() + limit_s
        while (held := self._read_hand()) is None and self._has_gripper_sensor:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: its gripper says for {limit_s:g} s that its fingers move: whether it "
                    "holds something is not known.",
                    remedy="Look at the gripper. If it was switched off, activate it: on the pendant, or "
                    "by a program.",
                )
            time.sleep(POLL_S)
        return held

    def _read_hand(self) -> bool | None:
        """Whether the gripper holds something; None if no gripper reports it, or its fingers move."""
        if self._gripper_input is not None and self._stream is not None:
            return self._stream.read_state().input(self._gripper_input)
        if self._gripper is None:
            return None
        raw = self._gripper.exchange(b"GET OBJ", self.limit_s("answer", ANSWER_S))
        answer = raw.decode("ascii", "replace").strip()
        found = re.fullmatch(r"OBJ ([0-3])", answer)
        if found is None:
            raise Garbled(f"{self.name}: {answer!r} does not tell what the gripper holds.")
        number = int(found[1])
        return None if number == protocol.MOVING else number != protocol.EMPTY

    # -- one question ------------------------------------------------------------------------

    def _ask(self, question: str, limit_s: float = 0.0) -> str:
        answer = self.link.exchange(question.encode(), limit_s or self.limit_s("answer", ANSWER_S))
        return answer.decode("utf-8", "replace").strip()

    def _ask_status(self, question: str, begins: str) -> str:
        return self._parse_status(self._ask(question), question, begins)

    def _parse_status(self, answer: str, question: str, begins: str) -> str:
        if not answer.startswith(begins):
            raise Garbled(f"{self.name}: {answer!r} is no answer to {question!r}.")
        return answer.removeprefix(begins).strip()

    def _read_mode(self) -> str:
        return self._ask_status("robotmode", "Robotmode:")

    def _read_safety(self) -> str:
        """The safety status. A controller that does not know ``safetystatus`` (before 5.4) reports its
        ``safetymode``."""
        answer = self._ask("safetystatus")
        if _is_not_understood(answer):
            return self._ask_status("safetymode", "Safetymode:")
        return self._parse_status(answer, "safetystatus", "Safetystatus:")

    def _read_state(self) -> str:
        answer = self._ask("programState")
        state = answer.partition(" ")[0]
        if state not in (protocol.STOPPED, protocol.PLAYING, protocol.PAUSED):
            raise Garbled(f"{self.name}: {answer!r} is no state of a program.")
        return state

    def _order(self, command: str, *good: str, limit_s: float = 0.0) -> None:
        """Send a command; accepting answers begin with ``good``. Raises DeviceError if it is refused: nothing
        has moved then."""
        answer = self._ask(command, limit_s)
        if not answer.startswith(good):
            raise DeviceError(
                f"{self.name}: the controller refuses {command!r}: {answer}",
                effects="none",
                remedy="Look at the pendant.",
            )

    def _await_status(self, what: str, ask: Callable[[], str], *wanted: str) -> None:
        limit_s = self.limit_s("power", POWER_S)
        deadline = time.monotonic() + limit_s
        while (answer := ask()) not in wanted:
            if time.monotonic() > deadline:
                raise self.make_refusal(f"its {what} is {answer} after {limit_s:g} s", "Look at the pendant.")
            time.sleep(POLL_S)

    def _recognise(self, link: Link) -> str:
        greeting = link.receive(self.limit_s("answer", ANSWER_S))
        if not greeting.startswith(protocol.GREETING):
            return f"what says {greeting[:40]!r}"
        serial = self._ask("get serial number")  # unknown before software 5.6 and 3.12 (CB3)
        self.check_unit("" if _is_not_understood(serial) else serial)
        version = self._ask("PolyscopeVersion")
        self.note_firmware("" if _is_not_understood(version) else version)
        return WHO


def _is_not_understood(answer: str) -> bool:
    return answer.lower().startswith("could not understand")


def _describe_value(value: Any) -> str:
    return {True: "true", False: "false", "": "none"}.get(value, str(value))


def _find_state(robot: rtde.Robot) -> str:
    """The program state in the dashboard's words; empty while it changes, or while the arm still moves."""
    if robot.runtime_state == rtde.STOPPED:
        return protocol.STOPPED if robot.stands_still else ""
    return {rtde.PLAYING: protocol.PLAYING, rtde.PAUSED: protocol.PAUSED}.get(robot.runtime_state, "")
