"""The device's commands.

Write down here the source of each command, and which commands were never tried on hardware.
"""

from __future__ import annotations

import time

from labos.errors import Garbled
from labos.link import Link, SerialWire, Terminated
from labos.node import DeviceError, assume_motion

ANSWER_S, MOTION_S, POLL_S = 2.0, 90.0, 0.05

REFUSALS = {"EMPTY": ("no plate is in the nest", "Put one there."), "BUSY": ("it is at work", "Wait.")}
"""Answers with which nothing has moved: what they mean, and what to do."""

FAULTS = {"JAMMED": ("its drive is jammed", "Free the plate, then reset the module.")}


class Driver:
    """One device on a serial line."""

    def __init__(self, name: str, port: str) -> None:
        self.name = name
        self.line = Link(SerialWire(port, baudrate=9600), Terminated(b"\r\n"), name=name, identify=_recognise)

    def open(self) -> None:
        """Raises NotConnected, WrongDevice."""
        self.line.open()

    def close(self) -> None:
        self.line.close()

    def work(self, time_s: float) -> None:
        """Raises DeviceError, which says how much of the motion was carried out."""
        before = self._works_done()
        answer = self._ask(f"WORK {time_s:.1f}")
        if answer in REFUSALS:
            why, remedy = REFUSALS[answer]
            raise DeviceError(f"{self.name}: {why}.", effects="none", remedy=remedy)
        if answer != "OK":
            raise Garbled(f"{self.name}: {answer!r} is not a valid answer to WORK.")
        with assume_motion():
            self._await_rest()
            if self._works_done() != before + 1:  # a device that has restarted rests, too
                raise DeviceError(f"{self.name} is idle, but has not done the work. It may have restarted.")

    def reset(self) -> None:
        if (answer := self._ask("RESET")) != "OK":
            raise DeviceError(f"{self.name}: {answer!r} is not a valid answer to RESET.")

    def is_idle(self) -> bool:
        return self._ask("STAT") == "IDLE"

    def sees_a_plate(self) -> bool:
        answer = self._ask("PLATE")
        if answer not in ("YES", "NO"):
            raise Garbled(f"{self.name}: {answer!r} is not a valid answer to PLATE.")
        return answer == "YES"

    def _works_done(self) -> int:
        """How often it has worked since it was switched on."""
        answer = self._ask("COUNT")
        if not answer.isdecimal():
            raise Garbled(f"{self.name}: {answer!r} is not a number.")
        return int(answer)

    def _await_rest(self) -> None:
        deadline = time.monotonic() + MOTION_S
        while (state := self._ask("STAT")) == "BUSY":
            if time.monotonic() > deadline:
                raise DeviceError(f"{self.name} is still at work after {MOTION_S:g} s.")
            time.sleep(POLL_S)
        if state in FAULTS:
            why, remedy = FAULTS[state]
            raise DeviceError(f"{self.name}: {why}.", remedy=remedy)
        if state != "IDLE":
            raise Garbled(f"{self.name}: {state!r} is not a state.")

    def _ask(self, question: str) -> str:
        return self.line.exchange(question.encode("ascii"), ANSWER_S).decode("ascii", "replace")


def _recognise(link: Link) -> str:
    """The name of the device that answers: two cables may have been swapped."""
    return link.exchange(b"WHO", ANSWER_S).decode("ascii", "replace")
