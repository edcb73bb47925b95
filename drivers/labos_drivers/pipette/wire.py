"""A simulated pipette at the far end of its line: a stepper motor, a plunger, and commands of one letter."""

from __future__ import annotations

import re

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos_drivers._onwire import OnLine
from labos_drivers.pipette import protocol
from labos_drivers.pipette.simulator import EJECTS_S, STARTS_S

USUAL_STEPS_S = 1400
BAD_COMMAND, BAD_OPERAND = 2, 3
WORD = re.compile(r"([A-Za-z])(\d*)")


class PipetteOnWire(OnLine):
    """The simulated pipette. ``started``: it has been initialised before. ``stuck``: its plunger does not
    move."""

    line_end = b"\r"

    def __init__(self, setup: Setup, end: FarEnd | None = None, *, started: bool = True) -> None:
        super().__init__(setup, end)
        self.kind = protocol.KINDS[setup.config.get("kind", "z_pump")]
        self.initialised = started
        self.stuck = False
        self.position = 0
        self._goal = 0
        self._began_s, self._steps_s = 0.0, USUAL_STEPS_S
        self._busy = False
        self._error = 0

    def put(self, position: int) -> None:
        """A person moves the plunger."""
        self.position = self._goal = position

    # -- receiving ---------------------------------------------------------------------------

    def obey(self, line: str) -> None:
        text = line.lstrip("\0")
        if text.startswith(f"/{protocol.ADDRESS.decode()}"):
            self.send(self._answer(text[2:]))

    def _answer(self, text: str) -> bytes:
        if text == "Q":
            error, self._error = self._error, 0
            return protocol.write(not self._busy, error)
        if text in ("?", "?0"):
            return protocol.write(not self._busy, 0, str(self._compute_position()))
        if text == "?2":
            return protocol.write(not self._busy, 0, str(self._steps_s))
        if text == "&":
            return protocol.write(not self._busy, 0, "simulated")
        if text == "T":
            self._terminate()
            return protocol.write(True, 0)
        if not text.endswith("R"):
            return protocol.write(not self._busy, BAD_COMMAND)
        if self._busy:
            return protocol.write(False, protocol.OVERFLOW)
        error = self._run(text[:-1])
        return protocol.write(not self._busy, error)

    def _run(self, commands: str) -> int:
        """Start commands. Returns an error code, or 0 if the pump accepts them."""
        if commands == self.kind.initialise:
            return self._initialise()
        if commands == self.kind.eject and self.initialised:
            return self._begin(EJECTS_S, "eject")
        if "".join(match[0] for match in WORD.finditer(commands)) != commands:
            return BAD_COMMAND
        for letter, digits in WORD.findall(commands):
            number = int(digits or 0)
            if letter in "AaPpDd":
                if not self.initialised:
                    return protocol.NOT_INITIALISED
                change = {"A": number - self.position, "P": number, "D": -number}[letter.upper()]
                if not 0 <= self.position + change <= self.kind.steps:
                    return BAD_OPERAND
                self._stroke(self.position + change)
            elif letter == "V":
                if not protocol.SLOWEST_STEPS_S <= number <= protocol.FASTEST_STEPS_S:
                    return BAD_OPERAND
                self._steps_s = number
            elif letter not in "vcSLmhNKk":
                return BAD_COMMAND
        return 0

    # -- motions -----------------------------------------------------------------------------

    def _initialise(self) -> int:
        self.initialised = True
        self._steps_s = USUAL_STEPS_S
        self.position = self._goal = 0
        return self._begin(STARTS_S, "initialise")

    def _begin(self, seconds: float, verb: str) -> int:
        self._busy = True
        self.after(seconds, lambda: self._end(verb))
        return 0

    def _end(self, verb: str) -> None:
        self._busy = False
        self.position = self._goal = 0
        self.world.work(self.name, verb)

    def _stroke(self, goal: int) -> None:
        if goal == self.position:
            return
        if self.stuck:
            self._error, self.initialised = protocol.OVERLOAD, False
            return
        self._busy, self._goal, self._began_s = True, goal, self.now_s()
        self.after(abs(goal - self.position) / self._steps_s, self._arrive, exact=True)

    def _arrive(self) -> None:
        self._note_position(self._goal)

    def _note_position(self, here: int) -> None:
        change, self.position, self._goal, self._busy = here - self.position, here, here, False
        microlitres = round(abs(change) * self.kind.volume_ul / self.kind.steps, 3)
        if change:
            self.world.work(self.name, "aspirate" if change > 0 else "dispense", ul=microlitres)

    def _compute_position(self) -> int:
        if self._goal == self.position:
            return self.position
        steps = round((self.now_s() - self._began_s) * self._steps_s)
        way = self._goal - self.position
        return self.position + max(min(steps, abs(way)), 0) * (1 if way > 0 else -1)

    def _terminate(self) -> None:
        if self._busy and self._goal != self.position:
            self.forget_plans()
            self._note_position(self._compute_position())

    def damage(self, crash: Crash) -> None:
        """Do nothing: the pump does not notice a collision."""
