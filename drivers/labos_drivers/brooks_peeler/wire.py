"""A simulated XPeel at the far end of a serial line.

Two assumptions are made here, because no public source describes them. An illegal command is answered with
``*ready:05,00,00`` and no ``*ack``. A device in motion does not answer at all.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos_drivers._onwire import OnLine
from labos_drivers.brooks_peeler import protocol

ROLL = 600
NONE = (0, 0, 0)


class PeelerOnWire(OnLine):
    """The simulated device. ``peels`` is true during a peel. With ``homes``, it homes when it is switched on,
    as the real one does; else it has homed before. A seal check takes ``check_s`` (lab seconds)."""

    drawers = ("default",)

    def __init__(
        self, setup: Setup, end: FarEnd | None = None, *, homes: bool = False, check_s: float = 10.0
    ) -> None:
        super().__init__(setup, end)
        self._check_s = check_s
        self.codes: tuple[int, ...] = NONE
        self.cover_is_shut = True
        self.checks_plate = True
        self.peels = False
        self._homes = homes
        self._busy = False
        self._moved = False
        self._used = 0
        self._threshold = 500

    def power_on(self) -> None:
        if self._homes:
            self._restart()

    # -- receiving ---------------------------------------------------------------------------

    def obey(self, line: str) -> None:
        if self._busy:
            return
        name, _, argument = line.partition(":")
        answers: dict[str, Callable[[], None]] = {
            "*stat": lambda: None,
            "*version": lambda: self._send_line("*1.4"),
            "*tapeleft": self._send_tape,
            "*sealstat": lambda: self._send_line(f"*seal:{self._threshold:03d}"),
        }
        motions: dict[str, tuple[float, Callable[[], tuple[int, ...]]]] = {
            "*reset": (12, self._start_afresh),
            "*sealcheck": (self._check_s, self._check_seal),
            "*movein": (3, lambda: NONE),
            "*moveout": (3, lambda: NONE),
            "*movedown": (3, lambda: NONE),
            "*moveup": (1, lambda: NONE),
            "*movespool": (2, lambda: NONE),
            "*platecheck": (0.1, lambda: self._set_check(argument)),
            "*sealhigher": (0.1, lambda: NONE),
            "*seallower": (0.1, lambda: NONE),
        }
        if name in answers and not argument:
            answers[name]()
            self._send_ready()
        elif name == "*restart":
            self._send_line("*ack")
            self.codes = NONE
            self.after(1, self._restart)
        elif name == "*xpeel" and re.fullmatch("[1-9][1-4]", argument):
            self._send_line("*ack")
            self.peels = True
            self._move(
                17.5 + protocol.ADHERE_S[int(argument[1]) - 1], lambda: self._peel(int(argument[0]), argument)
            )
        elif name in motions:
            self._send_line("*ack")
            self._move(*motions[name])
        else:
            self.codes = (5, 0, 0)
            self._send_ready()

    # -- motions -----------------------------------------------------------------------------

    def _move(self, lab_s: float, work: Callable[[], tuple[int, ...]]) -> None:
        self._busy = True
        self.shut(*self.drawers)
        self.world.enter(self.name, self.name)

        def end() -> None:
            self.codes = (*(work() if self.cover_is_shut else (51,)), 0, 0, 0)[:3]
            self._finish()

        self.after(lab_s, end)

    def _finish(self) -> None:
        self._busy = self.peels = False
        self.open(*self.drawers)
        self.world.leave(self.name)
        self._send_ready()

    def damage(self, crash: Crash) -> None:
        self.forget_plans()
        self.codes = (2, 0, 0)
        self._busy = self.peels = False
        self._send_ready()

    def stop_button(self) -> None:
        """A person presses the stop button."""
        self.after(0, self._stop, exact=True)

    def _stop(self) -> None:
        if self._busy:
            self.forget_plans()
            self.codes = (9, 0, 0)
            self._finish()

    def _peel(self, parameter_set: int, argument: str) -> tuple[int, ...]:
        nest = self.place("default")
        plate = self.top(nest)
        if not plate and self.checks_plate:
            return (protocol.NO_PLATE,)
        if self._tape_left() < 1:
            return (protocol.OUT_OF_TAPE,)
        self.crash_if_lidded(nest, "peels a lid")
        self.world.use(self.name, "tape", 1)
        self._used += 1
        self._moved = True
        adhere_s = protocol.ADHERE_S[int(argument[1]) - 1]
        self.world.work(self.name, "peel", nest, set=parameter_set, adhere_s=adhere_s)
        few = (20,) if self._tape_left() < protocol.FEW else ()
        full = (21,) if ROLL - self._used < protocol.FEW else ()
        return few + full

    def _check_seal(self) -> tuple[int, ...]:
        plate = self.top(self.place("default"))
        if not plate and self.checks_plate:
            return (protocol.NO_PLATE,)
        return (protocol.SEAL,) if plate and self.is_sealed(plate) else ()

    def _start_afresh(self) -> tuple[int, ...]:
        self._moved = True
        return NONE

    def _set_check(self, argument: str) -> tuple[int, ...]:
        self.checks_plate = argument == "y"
        return NONE

    def _restart(self) -> None:
        self._busy = True
        self._send_line("*poweron")
        self._send_line("*homing")

        def finish_homing() -> None:
            self.codes = NONE
            self._finish()

        self.after(10, finish_homing)

    # -- sending -----------------------------------------------------------------------------

    def _tape_left(self) -> float:
        left = self.world.find_level(self.name, "tape")
        return ROLL - self._used if left is None else left

    def _send_tape(self) -> None:
        supply, room = int(self._tape_left() // 10), (ROLL - self._used) // 10
        unknown = (protocol.UNKNOWN_TAPE,) * 2
        self._send_line("*tape:{:02d},{:02d}".format(*((supply, room) if self._moved else unknown)))

    def _send_ready(self) -> None:
        self._send_line("*ready:{:02d},{:02d},{:02d}".format(*self.codes))

    def _send_line(self, text: str) -> None:
        self.send(text.encode() + protocol.END)
