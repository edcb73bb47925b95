"""What is killed with SIGKILL, and when: a plan from a seed."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.apps.together.bench import Bench
from tests.apps.together.programs import Program
from tests.apps.together.sinks import Sinks

WHAT = ("kernel", "application", "worker", "broker")
MORE = ("power", "node", "sink")
"""Harsher: the kernel with all nodes and applications at once, one node, and the process of a sink."""


class Kill(NamedTuple):
    """``what`` is killed when the log has so many events more than when the last application had begun.
    ``which`` chooses among applications."""

    what: str
    at: int
    which: int = 0


def plan_of(seed: int, what: Sequence[str], events: int, *, times: int = 1) -> list[Kill]:
    """Each of them so many times in the middle of so many events: between 5 and 70 %. A worker is killed
    once, in the midst of the first computation behind its place in the first 25 %."""
    choose = random.Random(seed)
    found = []
    again = [each for each in what if each != "worker"] * (times - 1)
    for each in (*what, *again):
        low, high = (0.0, 0.25) if each == "worker" else (0.05, 0.7)
        found.append(
            Kill(each, choose.randint(round(low * events), round(high * events)), choose.randrange(60))
        )
    return sorted(found, key=lambda kill: kill.at)


class Killer:
    """Carries out a plan, step by step, whenever it is asked to ``look``. ``done`` says what was killed at
    which position, and how long it was away."""

    def __init__(self, bench: Bench, programs: Sequence[Program], sinks: Sinks, plan: Sequence[Kill]) -> None:
        self._bench, self._programs, self._sinks = bench, programs, sinks
        self._left = list(plan)
        self.begun_at = 0
        self._broker_back: threading.Thread | None = None
        self.done: list[str] = []

    def look(self, position: int) -> None:
        """Kill what is due at this position of the log, and start it again: nothing before all programs
        have begun, at ``begun_at``."""
        if not self.begun_at and all(program.experiments or program.find() for program in self._programs):
            self.begun_at = position
        due = [kill for kill in self._left if self.begun_at and self.begun_at + kill.at <= position]
        for kill in due:
            if self._carry_out(kill, position):
                self._left.remove(kill)

    def finish(self) -> list[str]:
        """What has not been killed; the broker is back."""
        if self._broker_back is not None:
            self._broker_back.join()
        return [kill.what for kill in self._left]

    def _carry_out(self, kill: Kill, position: int) -> bool:
        begun = time.monotonic()
        match kill.what:
            case "kernel":
                self._bench.kill()
                self._bench.start_again()
                self._note("kernel", position, begun)
                return True
            case "application":
                return self._kill_application(kill.which, position)
            case "worker":
                return self._kill_worker(position)
            case "broker":
                return self._kill_broker(position)
            case "power":
                return self._cut_power(position)
            case "node":
                return self._kill_node(kill.which, position)
            case "sink":
                sink = self._sinks.sinks[kill.which % len(self._sinks.sinks)]
                sink.kill()
                sink.start()
                self._note(f"sink {sink.target.partition(':')[0]}", position, begun)
                return True
        raise AssertionError(kill)

    def _kill_application(self, which: int, position: int) -> bool:
        alive = [program for program in self._programs if not program.has_ended()]
        if not alive:
            return False
        begun, program = time.monotonic(), alive[which % len(alive)]
        program.kill()
        program.start()
        self._note(f"application {program.app.name}", position, begun)
        return True

    def _kill_worker(self, position: int) -> bool:
        """Only one that computes at the moment."""
        workers = [pid for program in self._programs if not program.has_ended() for pid in program.workers()]
        for pid in workers:
            with contextlib.suppress(OSError):
                if _is_busy(pid):
                    os.kill(pid, signal.SIGKILL)
                    self.done.append(f"worker at {position}")
                    return True
        return False

    def _kill_broker(self, position: int) -> bool:
        """It comes back by itself, while all goes on."""
        broker, begun = self._sinks.broker, time.monotonic()
        assert broker is not None
        if self._broker_back is not None and self._broker_back.is_alive():
            return False
        broker.kill()

        def start_again() -> None:
            broker.start()
            self._note("broker", position, begun)

        self._broker_back = threading.Thread(target=start_again, name="broker")
        self._broker_back.start()
        return True

    def _cut_power(self, position: int) -> bool:
        """Kernel, nodes and applications at once."""
        begun, alive = time.monotonic(), [program for program in self._programs if not program.has_ended()]
        for program in alive:
            program.kill()
        self._bench.kill()
        for pid in self._bench.nodes().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._bench.start_again()
        for program in alive:
            program.start()
        self._note("power", position, begun)
        return True

    def _kill_node(self, which: int, position: int) -> bool:
        """The lab starts another one."""
        nodes = sorted(self._bench.nodes().items())
        name, pid = nodes[which % len(nodes)]
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        self.done.append(f"node {name} at {position}")
        return True

    def _note(self, what: str, position: int, begun: float) -> None:
        self.done.append(f"{what} at {position}, back after {time.monotonic() - begun:.1f} s")


def _is_busy(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "RD"
