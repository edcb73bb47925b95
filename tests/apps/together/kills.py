"""What is killed with SIGKILL, and when: a plan from a seed."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from collections.abc import Sequence
from typing import NamedTuple

from tests.apps.together.bench import Bench
from tests.apps.together.programs import Program
from tests.apps.together.sinks import Sinks

WHAT = ("kernel", "application", "worker", "broker")


class Kill(NamedTuple):
    """``what`` is killed when the log has so many events; of applications, the one of that number."""

    what: str
    at: int
    which: int = 0


def plan_of(seed: int, what: Sequence[str], events: int, programs: int) -> list[Kill]:
    """Each of them once, somewhere in the middle of so many events: between 15 and 70 %."""
    choose = random.Random(seed)
    low, high = round(0.15 * events), round(0.7 * events)
    return sorted(
        (Kill(each, choose.randint(low, high), choose.randrange(programs)) for each in what),
        key=lambda kill: kill.at,
    )


class Killer:
    """Carries out a plan, step by step, whenever it is asked to ``look``. ``done`` says what was killed at
    which position, and how long it was away."""

    def __init__(self, bench: Bench, programs: Sequence[Program], sinks: Sinks, plan: Sequence[Kill]) -> None:
        self._bench, self._programs, self._sinks = bench, programs, sinks
        self._left = list(plan)
        self.done: list[str] = []

    def look(self, position: int) -> None:
        """Kill what is due at this position of the log, and start it again."""
        for kill in [kill for kill in self._left if kill.at <= position]:
            if self._carry_out(kill, position):
                self._left.remove(kill)

    def left(self) -> list[Kill]:
        """What has not been killed."""
        return list(self._left)

    def _carry_out(self, kill: Kill, position: int) -> bool:
        begun = time.monotonic()
        match kill.what:
            case "kernel":
                self._bench.kill()
                self._bench.start_again()
            case "application":
                alive = [program for program in self._programs if not program.has_ended()]
                if not alive:
                    return False
                program = alive[kill.which % len(alive)]
                program.kill()
                program.start()
                return self._note(f"application {program.app.name}", position, begun)
            case "worker":
                workers = [
                    pid for program in self._programs if not program.has_ended() for pid in program.workers()
                ]
                if not workers:
                    return False  # none computes at the moment
                with contextlib.suppress(ProcessLookupError):
                    os.kill(workers[0], signal.SIGKILL)
            case "broker" if self._sinks.broker is not None:
                self._sinks.broker.kill()
                self._sinks.broker.start()
        return self._note(kill.what, position, begun)

    def _note(self, what: str, position: int, begun: float) -> bool:
        self.done.append(f"{what} at {position}, back after {time.monotonic() - begun:.1f} s")
        return True
