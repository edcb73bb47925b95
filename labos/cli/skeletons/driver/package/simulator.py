"""A simulated device at the far end of a real line. It knows nothing of the driver, nor of effects: what it
does, it does on the bench (``self.world``)."""

from __future__ import annotations

from labos.link import DeviceOnLine
from labos.node import Crash


class Device(DeviceOnLine):
    """Works on the plate in its nest, and feels whether there is one."""

    line_end = b"\r\n"
    state = "IDLE"
    is_blocked = False
    works_done = 0

    def obey(self, line: str) -> None:
        match line.split():
            case ["WHO"]:
                self.send_line("NAME 1")
            case ["STAT"]:
                self.send_line(self.state)
            case ["COUNT"]:
                self.send_line(f"{self.works_done}")
            case ["PLATE"]:
                self.send_line("YES" if self.has_plate() else "NO")
            case ["RESET"]:
                self.forget_plans()
                self.state = "IDLE"
                self.send_line("OK")
            case ["WORK", seconds]:
                self.send_line(self._begin(float(seconds)))
            case _:
                self.send_line("WHAT")

    def has_plate(self) -> bool:
        return bool(self.world.at(self.place("nest")))

    def damage(self, crash: Crash) -> None:
        self.forget_plans()
        self.state = "JAMMED"

    def _begin(self, seconds: float) -> str:
        if self.state != "IDLE" or not self.has_plate():
            return "EMPTY" if self.state == "IDLE" else "BUSY"
        self.state = "BUSY"
        self.after(seconds, lambda: self._end(seconds))
        return "OK"

    def _end(self, seconds: float) -> None:
        if self.is_blocked:
            self.state = "JAMMED"
            return
        self.world.work(self.name, "work", self.place("nest"), time_s=seconds)
        self.works_done += 1
        self.state = "IDLE"
