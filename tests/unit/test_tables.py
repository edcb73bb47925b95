"""Tables on a terminal of 80 columns: what makes no sense when it is broken stays whole."""

from __future__ import annotations

import os
import pty
import sys

from labos.cli._out import show_table

PROGRAM = """
from labos.cli._out import show_table
show_table(
    ("id", "since", "of", "question"),
    [("I12", "2026-11-23 14:39:36.968+00:00", "R3 (Color Picker - Mix Colors)", "Where is P7? " * 6)],
)
"""


def on_terminal(program: str, columns: int) -> list[str]:
    """What a program shows on a terminal so wide, line by line."""
    pid, fd = pty.fork()
    if pid == 0:
        os.environ |= {"COLUMNS": str(columns), "TERM": "xterm"}
        os.execv(sys.executable, [sys.executable, "-c", program])
    said = b""
    try:
        while piece := os.read(fd, 4096):
            said += piece
    except OSError:  # how Linux ends a terminal
        pass
    finally:
        os.close(fd)
    assert os.waitpid(pid, 0)[1] == 0, said
    return said.decode().splitlines()


def test_times_and_ids_are_not_broken() -> None:
    lines = on_terminal(PROGRAM, 80)
    assert max(len(line) for line in lines if "\x1b" not in line) <= 80
    assert any("I12" in line and "2026-11-23 14:39:36.968+00:00" in line for line in lines), lines
    assert len(lines) > 3, "the question is wrapped"


def test_piped_nothing_is_cut(capsys: object) -> None:
    show_table(("id", "text"), [("I12", "x" * 200)])
    assert "x" * 200 in capsys.readouterr().out  # type: ignore[attr-defined]
