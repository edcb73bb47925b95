"""A person comes out of a workcell and is asked on a terminal, a real one, what was changed there."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.lab_process import PATIENCE_S, Up, labos

CTRL_C, CTRL_D = b"\x03", b"\x04"


class Terminal:
    """A command on a terminal of its own."""

    def __init__(self, *argv: str) -> None:
        self.master, slave = pty.openpty()
        self.said = ""
        self._seen = 0
        self.process = subprocess.Popen(
            [sys.executable, "-m", "labos", *argv],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(slave)

    def kill(self) -> None:
        """Leave no process behind, whatever happened."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def until(self, pattern: str) -> str:
        """Read on until something is said; returns what was said since the last time."""
        give_up = time.monotonic() + PATIENCE_S
        while not (found := re.compile(pattern).search(self.said, self._seen)):
            ready, _, _ = select.select([self.master], [], [], max(give_up - time.monotonic(), 0))
            assert ready, f"not {pattern!r}, but: {self.said}"
            self.said += os.read(self.master, 4096).decode()
        new, self._seen = self.said[self._seen : found.end()], found.end()
        return new

    def type(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def answer(self, answer_to: Callable[[str], str], last: bytes) -> None:
        """Answer each question about a station, and the last one with some keys."""
        while True:
            asked = self.until(r"\[kept\]: |Enter: none: |\[y/N\]: ")
            if asked.endswith("[y/N]: "):
                self.type(last)
                return
            self.type(answer_to(asked.rstrip().rpartition("\n")[2]).encode() + b"\n")

    def end(self, keys: bytes = b"") -> int:
        """Read it to its end; its exit code. Keys are pressed again while nothing comes of them: what a
        terminal gets between two questions, while it changes its mode, may be lost."""
        while True:
            while keys and not select.select([self.master], [], [], 1.0)[0]:
                self.type(keys)
            try:
                read = os.read(self.master, 4096)
            except OSError:  # so a terminal ends whose program has
                break
            if not read:
                break
            self.said += read.decode()
        os.close(self.master)
        return self.process.wait(PATIENCE_S)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "500")
    yield up
    up.clean_up()


@pytest.fixture
def terminal() -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def open_(*argv: str) -> Terminal:
        opened.append(Terminal(*argv))
        return opened[-1]

    yield open_
    for each in opened:
        each.kill()


def stands(lab: Up, *places: str) -> list[list[str]]:
    with lab.client() as client:
        stations = {s["name"]: s["labware"] for s in client.state(waits=False)["stations"]}
    return [stations[f"rpl/{place}"] for place in places]


def test_the_lab_asks_what_was_changed_and_takes_all_of_it_or_nothing(
    lab: Up, terminal: Callable[..., Terminal]
) -> None:
    lab.start_with("sciclops", "pf400", "sealer", "hidex", "camera_module")
    home = ("--home", str(lab.home))
    for place in ("sealer.default", "camera_module.plate_station", "hidex.default"):
        assert labos("place", place, "plate96", *home).returncode == 0
    before = [["P1"], ["P2"], ["P3"], []]
    places = ("sealer.default", "camera_module.plate_station", "hidex.default", "wc.output.3")
    assert stands(lab, *places) == before
    assert labos("access", "rpl", "--no-park", "--json", *home).returncode == 0
    leave = ("access", "rpl", "--done", *home)

    for keys in (CTRL_C, CTRL_D):  # in the middle of it
        screen = terminal(*leave)
        screen.until(r"sealer.default: P1 \(plate96\) \[kept\]: ")
        screen.type(b"empty\n")
        screen.until(r"\[kept\]: ")
        screen.type(keys)
        assert screen.end(keys) == 130
        assert "Nothing was reported: rpl stays held." in screen.said

    elsewhere = iter(["nonsense", "wc.nowhere=P3", "wc.output=P3", "wc.output.3=P3", ""])

    def answer(asked: str) -> str:
        if "Other changes" in asked:
            return next(elsewhere, "")
        return "empty" if "sealer.default" in asked or "hidex.default" in asked else ""

    screen = terminal(*leave)
    screen.answer(answer, b"n\n")
    assert screen.end() == 130
    assert "Write STATION=WHAT" in screen.said
    assert "There is no station 'wc.nowhere' here." in screen.said
    assert "wc.output has shelves: wc.output.1 to wc.output.14" in screen.said
    assert stands(lab, *places) == before
    assert "workcell.access_ended" not in lab.types()

    elsewhere = iter(["wc.output.3=P3", ""])
    screen = terminal(*leave)
    screen.answer(lambda asked: "nonsense" if "camera" in asked else answer(asked), b"y\n")
    screen.until("None of your answers was recorded")  # there is no such labware
    elsewhere = iter(["wc.output.3=P3", ""])
    screen.answer(answer, b"y\n")
    assert screen.end() == 0
    assert screen.said.rstrip().endswith("rpl continues.")
    assert stands(lab, *places) == [[], ["P2"], [], ["P3"]]
    assert lab.interrupt() == 0
    assert lab.disagreements() == []


def test_without_a_terminal_it_says_that_nothing_was_told(lab: Up) -> None:
    lab.start_with("sciclops", "pf400")
    home = ("--home", str(lab.home))
    assert labos("access", "rpl", "--no-park", "--json", *home).returncode == 0
    done = labos("access", "rpl", "--done", *home)
    assert done.returncode == 0
    assert "No change was reported: the lab assumes that all labware stands as before" in done.stdout
    assert labos("access", "rpl", "--unchanged", *home).returncode == 2
    assert lab.interrupt() == 0
