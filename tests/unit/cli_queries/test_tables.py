"""Tables fit a terminal and keep times, ids and names whole; piped, they are never folded or cut."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labos.cli._table import folded_lines, plain_lines
from labos.core.ids import RunId
from labos.core.runs import RunCancelled
from tests.unit.cli_queries.test_queries import append

TIME = re.compile(r"2025-06-15 \d\d:\d\d:\d\d(\.\d{3})?\+00:00")
BEGUN = re.compile(r"2025-06-15")
COLORS = re.compile(r"\x1b\[[0-9;]*m")

words = st.text("abcé×", min_size=1, max_size=12)
cells = st.lists(words, max_size=8).map(" ".join)


def on_a_terminal(home: Path, *words: str, columns: int = 80) -> list[str]:
    """What ``labos`` writes on a terminal so wide."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    environment = {**os.environ, "TZ": "UTC", "LABOS_HOME": str(home), "TERM": "xterm"}
    environment.pop("COLUMNS", None)
    command = [sys.executable, "-m", "labos", *words]
    done = subprocess.Popen(command, stdout=its, stderr=subprocess.DEVNULL, env=environment)
    os.close(its)
    told = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # so a terminal ends whose program has
            break
        if not part:
            break
        told += part
    os.close(ours)
    assert done.wait(30) == 0, told
    return COLORS.sub("", told.decode()).splitlines()


@pytest.mark.parametrize(
    "words", [("runs",), ("runs", "R1"), ("labware",), ("labware", "P1"), ("stations",), ("inventory",)]
)
def test_a_table_fits_a_terminal_and_breaks_no_time(home: Path, words: tuple[str, ...]) -> None:
    append(home, RunCancelled(RunId("R2"), "the plate was the wrong one, and its seal was not tight at all"))
    lines = on_a_terminal(home, *words)
    assert max(map(len, lines)) <= 80, lines
    for line in lines:
        assert len(BEGUN.findall(line)) == len(TIME.findall(line)), line


def test_in_a_wide_terminal_each_row_is_one_line(home: Path) -> None:
    lines = on_a_terminal(home, "runs", columns=250)
    assert len(lines) == 3
    assert "15:08:20.000+00:00" in lines[1]


def test_a_last_column_is_wrapped_between_words() -> None:
    rows = [("R1", "one two three four five"), ("R2", "x" * 40)]
    assert folded_lines(("run", "why"), rows, 25) == [
        ("run  why", True),
        ("R1   one two three four", False),
        ("     five", False),
        ("R2   xxxxxxxxxxxxxxxxxxx…", False),
    ]


def test_columns_that_have_no_room_stand_below() -> None:
    rows = [("R1", "2025-06-15 15:06:40", "2025-06-15 15:08:40", "", "a few words")]
    assert folded_lines(("run", "from", "to", "by", "why"), rows, 40) == [
        ("run  from", True),
        ("    to                   why", True),
        ("R1   2025-06-15 15:06:40", False),
        ("    2025-06-15 15:08:40  a few words", False),
    ]


@given(st.integers(1, 6).flatmap(lambda n: st.lists(st.tuples(*[cells] * n), min_size=1, max_size=5)))
def test_nothing_is_lost_and_nothing_is_too_wide(table: list[tuple[str, ...]]) -> None:
    header, rows = tuple(f"c{at}" for at in range(len(table[0]))), table
    lines = [line for line, _ in folded_lines(header, rows, 40)]
    assert all(len(line) <= 40 for line in lines)
    told = sorted(" ".join(lines).split())
    wanted = sorted(" ".join(" ".join(row) for row in rows).split())
    assert [word for word in told if word not in header] == wanted
    assert len(plain_lines(header, rows)) == len(rows) + 1
