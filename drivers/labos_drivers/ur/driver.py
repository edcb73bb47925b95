"""Drives a real UR arm: its controller's stored programs, by the dashboard; what became of them is read from
its real-time data."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from labos.errors import Collision, DeviceError, Garbled
from labos.link import Link, TcpWire, Terminated
from labos.node import Setup
from labos_drivers._wired import Behind, Wired, aside, host_and_port, off_loop
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
SENSORS: dict[str, tuple[str, Any, Any]] = {
    "tool": ("pipette_input", "pipette", ""),
    "tip": ("tip_input", "sample", ""),
    "docked": ("dock_input", True, False),
}
"""By which input, and what it means when it is on and when it is off."""


class URDriver(Wired):
    """What the arm does stands in programs that were taught on the controller; the workcell file says
    which of them carries what from where to where."""

    deadlines = ("answer", "load", "begin", "program", "power", "fingers")
    where = ("host", "192.168.0.40")
    link: Link
    _gripper: Link | None = None
    _gripper_input: int | None = None
    _stream: Stream | None = None

    def __init__(self, setup: Setup, address: str, simulator: Behind | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._setup = setup
        dashboard, gripper, data = [*address.split(","), "", ""][:3]
        host, port = host_and_port(dashboard, protocol.DASHBOARD)
        self.link = Link(
            TcpWire(host, port),
            Terminated(protocol.END),
            name=setup.name,
            identify=self._recognise,
            expected=WHO,
        )
        if setup.config.get("rtde", True):
            self._stream = Stream(*host_and_port(data or host, rtde.PORT), setup.name)
        told = setup.config.get("gripper")
        if told == "robotiq":
            at = host_and_port(gripper or host, protocol.GRIPPER)
            self._gripper = Link(TcpWire(*at), Terminated(protocol.END), name=f"{setup.name} gripper")
        elif isinstance(told, dict):
            self._gripper_input = programs.input_of(setup, told, "input", "gripper")
        pendant = setup.config.get("pendant") or {}
        self._wired = {
            variable: (programs.input_of(setup, pendant, key, "pendant"), on, off)
            for variable, (key, on, off) in SENSORS.items()
            if key in pendant
        }

    @off_loop
    def connect(self) -> None:
        """Find the controller's ports; nothing moves. Raises NotConnected, WrongDevice."""
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
        """By the program for this way; ``program`` names it if the workcell file does not."""
        with self.motion():
            named = programs.carrying(self._setup, source, target, program)
            self._needs_hand(full=False)
            held = self._run(named)
            if not held and self._gripper_tells:
                raise DeviceError(
                    f"{self.name}: the gripper was not seen to hold anything in {named}.",
                    remedy=f"Look whether the labware stands at {source} still.",
                )
            self._expect(held=False, after=f"the transfer to {target}")

    @off_loop
    def pick(self, source: str) -> None:
        with self.motion():
            program = programs.carrying(self._setup, source, "gripper")
            self._needs_hand(full=False)
            self._run(program)
            self._expect(held=True, after=f"picking at {source}")

    @off_loop
    def put_down(self, target: str) -> None:
        with self.motion():
            program = programs.carrying(self._setup, "gripper", target)
            self._needs_hand(full=True)
            self._run(program)
            self._expect(held=False, after=f"putting down at {target}")

    @off_loop
    def run_program(self, program: str) -> None:
        with self.motion():
            self._run(programs.checked(self.name, program))

    @off_loop
    def pendant(self, action: str, /, **args: str) -> None:
        """An action of the pendant drop, by the program for it."""
        with self.motion():
            program = programs.pendant(self._setup, action, args)
            before, after = PENDANT[action]
            if action == "undock":
                after = {**after, "tool": args["tool"]}
            with self.at_rest():
                self._needs_sensed(before, f"{action} needs")
            self._run(program)
            with self.under_way():
                self._needs_sensed(after, f"after {action} it should be")

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """Out of a stop, powered and with its brakes released; no program runs. Nothing else moves."""
        self.resume()
        self.disconnect()  # all lines are opened anew: it may have been switched off meanwhile
        self._held()
        self._needs_remote()
        safety = self._safety()
        if safety == protocol.PROTECTIVE:
            self._order("unlock protective stop", "Protective stop releasing")
        elif safety in protocol.FAULTS:
            self._order("close safety popup", "closing safety popup")
            self._order("restart safety", "Restarting safety", "true")
            self._await_told("safety status", self._safety, protocol.NORMAL, protocol.REDUCED)
        elif safety not in (protocol.NORMAL, protocol.REDUCED):
            raise DeviceError(
                f"{self.name}: its safety status is {safety}.",
                effects="none",
                remedy="Release the emergency stop, then reset the module.",
            )
        if self._state() != protocol.STOPPED:
            self._order("stop", "Stopped")
        if self._mode() != protocol.RUNNING:
            self._order("power on", "Powering on")
            self._await_told("robotmode", self._mode, protocol.IDLE, protocol.RUNNING)
            self._order("brake release", "Brake releasing")
            self._await_told("robotmode", self._mode, protocol.RUNNING)

    @aside
    def stop(self) -> None:
        """Stops the program; the arm comes to rest where it is."""
        self._halted.set()
        if self._state() != protocol.STOPPED:
            self._order("stop", "Stopped")

    @aside
    def is_idle(self) -> bool:
        return self._state() == protocol.STOPPED and (self._stream is None or self._stream.now().stands_still)

    @aside
    def look(self) -> dict[str, Any]:
        """What its gripper tells of what it holds; nothing while its fingers move, or without one. What its
        inputs tell of pipette and tip, where they are wired to them."""
        held = self._held()
        return self._sensed() | ({} if held is None else {"labware": {"gripper": held}})

    # -- one program -------------------------------------------------------------------------

    def _run(self, program: str) -> bool | None:
        """Raises DeviceError unless it has run to its end. Returns whether the gripper held something
        meanwhile; None if it cannot tell."""
        with ExitStack() as end:
            with self.at_rest():
                self._refuse_unless_ready()
                self._order(f"load {program}", "Loading program", limit_s=self.limit_s("load", LOAD_S))
                self.unless_stopped()
                states = end.enter_context(self._watched())
            self._play(program)
            with self.under_way():
                held = self._see_through(program, states)
                self._refuse_unless_safe(program)
                self.unless_stopped()
        return held

    def _see_through(self, program: str, states: Iterator[str]) -> bool | None:
        """Wait for its end, and for the arm to stand still."""
        began, limit_s = time.monotonic(), self.limit_s("program", PROGRAM_S)
        played = False
        held = None
        for state in states:
            played = played or state == protocol.PLAYING
            if state == protocol.STOPPED and (played or self._halted.is_set()):
                break
            if (holds := self._held()) is not None:
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
    def _watched(self) -> Iterator[Iterator[str]]:
        """The states of its program from now on: as it tells them in real time, where none is missed,
        else as it answers when it is asked. One that has stopped while the arm still moves plays on."""
        if self._stream is None:
            yield self._asked_again()
            return
        with self._stream.watched() as told:
            yield (_state_of(robot) for robot in told)

    def _asked_again(self) -> Iterator[str]:
        while True:
            yield self._state()
            time.sleep(POLL_S)

    def _play(self, program: str) -> None:
        """Only a refusal that is known as one says that the program does not run."""
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
        safety = self._safety()
        if safety not in (protocol.NORMAL, protocol.REDUCED):
            kind = Collision if safety == protocol.PROTECTIVE else DeviceError
            raise kind(
                f"{self.name}: {safety} in {program}.",
                remedy="Look at the arm and at what it holds, then reset the module.",
            )

    def _refuse_unless_ready(self) -> None:
        """Raises DeviceError."""
        self._needs_remote()
        for what, ask, wanted in (
            ("safetystatus", self._safety, (protocol.NORMAL, protocol.REDUCED)),
            ("robotmode", self._mode, (protocol.RUNNING,)),
        ):
            if (told := ask()) not in wanted:
                raise DeviceError(f"{self.name}: its {what} is {told}.", remedy="Reset the module.")
        if (state := self._state()) != protocol.STOPPED:
            raise DeviceError(f"{self.name}: a program is {state}.", remedy="Wait, or reset the module.")

    def _needs_remote(self) -> None:
        answer = self._ask("is in remote control")
        if _is_not_understood(answer):
            return  # a CB3, which has no local mode, or software before 5.6: it refuses what it must not do
        if answer != "true":
            raise DeviceError(
                f"{self.name}: the controller is not in remote control.",
                effects="none",
                remedy="Switch it to remote control on the pendant.",
            )

    def _sensed(self) -> dict[str, Any]:
        if self._stream is None or not self._wired:
            return {}
        now = self._stream.now()
        inputs = self._wired.items()
        return {name: on if now.input(number) else off for name, (number, on, off) in inputs}

    def _needs_sensed(self, wanted: Mapping[str, Any], why: str) -> None:
        """Raises DeviceError if an input tells otherwise."""
        for variable, seen in self._sensed().items():
            if seen != wanted.get(variable, seen):
                raise DeviceError(
                    f"{self.name}: its {variable} is {_word(seen)}; {why} {_word(wanted[variable])}.",
                    remedy="Look at the arm and at the dock.",
                )

    def _needs_hand(self, *, full: bool) -> None:
        with self.at_rest():
            self._needs_sensed({"tool": ""}, "its gripper needs")
            if self._held_at_rest() is (not full):
                raise DeviceError(f"{self.name}: its hand is {'empty' if full else 'full'}.")

    def _expect(self, *, held: bool, after: str) -> None:
        """Raises DeviceError; a gripper that cannot be asked any more leaves open what it did."""
        with self.under_way():
            if self._held_at_rest() is (not held):
                raise DeviceError(
                    f"{self.name}: after {after} the gripper holds {'nothing' if held else 'something'}.",
                    remedy="Look where the labware is.",
                )

    @property
    def _gripper_tells(self) -> bool:
        """Whether there is a gripper that can be asked what it holds."""
        return self._gripper is not None or (self._gripper_input is not None and self._stream is not None)

    def _held_at_rest(self) -> bool | None:
        """What the gripper tells when its fingers stand still; None if there is none that could tell. Raises
        DeviceError if they do not come to rest: what they hold is not known then."""
        limit_s = self.limit_s("fingers", FINGERS_S)
        deadline = time.monotonic() + limit_s
        while (held := self._held()) is None and self._gripper_tells:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: its gripper says for {limit_s:g} s that its fingers move: whether it "
                    "holds something is not known.",
                    remedy="Look at the gripper. If it was switched off, activate it: on the pendant, or "
                    "by a program.",
                )
            time.sleep(POLL_S)
        return held

    def _held(self) -> bool | None:
        """None if there is no gripper that could tell, or its fingers move."""
        if self._gripper_input is not None and self._stream is not None:
            return self._stream.now().input(self._gripper_input)
        if self._gripper is None:
            return None
        told = self._gripper.exchange(b"GET OBJ", self.limit_s("answer", ANSWER_S))
        answer = told.decode("ascii", "replace").strip()
        found = re.fullmatch(r"OBJ ([0-3])", answer)
        if found is None:
            raise Garbled(f"{self.name}: {answer!r} does not tell what the gripper holds.")
        number = int(found[1])
        return None if number == protocol.MOVING else number != protocol.EMPTY

    # -- one question ------------------------------------------------------------------------

    def _ask(self, question: str, limit_s: float = 0.0) -> str:
        answer = self.link.exchange(question.encode(), limit_s or self.limit_s("answer", ANSWER_S))
        return answer.decode("utf-8", "replace").strip()

    def _told(self, question: str, begins: str) -> str:
        answer = self._ask(question)
        if not answer.startswith(begins):
            raise Garbled(f"{self.name}: {answer!r} is no answer to {question!r}.")
        return answer.removeprefix(begins).strip()

    def _mode(self) -> str:
        return self._told("robotmode", "Robotmode:")

    def _safety(self) -> str:
        """A controller that does not know ``safetystatus`` (before 5.4) tells its ``safetymode``."""
        answer = self._ask("safetystatus")
        if _is_not_understood(answer):
            return self._told("safetymode", "Safetymode:")
        if not answer.startswith("Safetystatus:"):
            raise Garbled(f"{self.name}: {answer!r} is no answer to 'safetystatus'.")
        return answer.removeprefix("Safetystatus:").strip()

    def _state(self) -> str:
        answer = self._ask("programState")
        state = answer.partition(" ")[0]
        if state not in (protocol.STOPPED, protocol.PLAYING, protocol.PAUSED):
            raise Garbled(f"{self.name}: {answer!r} is no state of a program.")
        return state

    def _order(self, command: str, *good: str, limit_s: float = 0.0) -> None:
        """Raises DeviceError if it is refused: nothing has moved then."""
        answer = self._ask(command, limit_s)
        if not answer.startswith(good):
            raise DeviceError(
                f"{self.name}: the controller refuses {command!r}: {answer}",
                effects="none",
                remedy="Look at the pendant.",
            )

    def _await_told(self, what: str, ask: Callable[[], str], *wanted: str) -> None:
        limit_s = self.limit_s("power", POWER_S)
        deadline = time.monotonic() + limit_s
        while (told := ask()) not in wanted:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: its {what} is {told} after {limit_s:g} s.",
                    effects="none",
                    remedy="Look at the pendant.",
                )
            time.sleep(POLL_S)

    def _recognise(self, link: Link) -> str:
        greeting = link.receive(self.limit_s("answer", ANSWER_S))
        if not greeting.startswith(protocol.GREETING):
            return f"what says {greeting[:40]!r}"
        serial = self._ask("get serial number")  # controllers before 5.6 and 3.12 do not know it
        self.see_unit("" if _is_not_understood(serial) else serial)
        version = self._ask("PolyscopeVersion")
        self.note_firmware("" if _is_not_understood(version) else version)
        return WHO


def _is_not_understood(answer: str) -> bool:
    return answer.lower().startswith("could not understand")


def _word(value: Any) -> str:
    return {True: "true", False: "false", "": "none"}.get(value, str(value))


def _state_of(robot: rtde.Robot) -> str:
    """In the dashboard's words; empty while it changes."""
    if robot.runtime_state == rtde.STOPPED:
        return protocol.STOPPED if robot.stands_still else ""
    return {rtde.PLAYING: protocol.PLAYING, rtde.PAUSED: protocol.PAUSED}.get(robot.runtime_state, "")
