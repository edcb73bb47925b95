"""An operator's shift, lived from the page that tells of it: real processes, the page's own commands.

Lines that are a call of ``labos`` and nothing else are carried out in this process, by the function
that the program itself calls; the lab and its nodes are processes of their own.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.cli.app import main
from labos.core.actions import ActionRequested
from labos.core.envelope import Record
from labos.core.registry import decode
from labos.core.state import LabState
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.services.truth import list_differences
from labos.store import open_store
from tests.docs.markdown import DOCS, Block, blocks
from tests.docs.test_tutorial import Reader, Terminal, check_output

PAGE = DOCS / "operators-shift.md"
PATIENCE_S = 60.0
OPERATOR = "olga"
REQUESTED = "action.requested"


class Operator(Reader):
    """Does what the page says, in the order in which it says it."""

    def do(self, block: Block) -> None:
        where = f"{PAGE.name}:{block.line}"
        if block.title:
            (self.folder / block.title).write_text(block.text)
        elif "terminal" in block.attributes and block.language == "bash":
            self.terminal = Terminal(block.text, self.folder, self.environment)
        elif "terminal" in block.attributes:
            assert self.terminal is not None
            self.terminal.read_until(block.text)
        elif block.attributes.get("after") == "Ctrl-C":
            assert self.terminal is not None
            self.terminal.press_ctrl_c()
            self.terminal.read_until(block.text)
            assert self.terminal.has_ended() == 0
        elif block.language == "text":
            check_output(block.text, self.said, where)
        elif "until" in block.attributes:
            self.repeat(block, where)
        else:
            self.said = "".join(self.type_line(line, where) for line in block.text.splitlines())

    def repeat(self, block: Block, where: str) -> None:
        """A command that a person types until it prints something."""
        give_up = time.monotonic() + PATIENCE_S
        while block.attributes["until"] not in self.said:
            assert time.monotonic() < give_up, f"{where}: not within {PATIENCE_S:g} s:\n{self.said}"
            self.said = self.type_line(block.text.strip(), where)

    def type_line(self, line: str, where: str) -> str:
        """What a line prints that a person types."""
        if line.startswith("labos ") and not set(line) & set("|>$"):
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = main(shlex.split(line)[1:])
            printed = said.getvalue()
        else:
            done = subprocess.run(
                ["bash", "-ec", line],
                cwd=self.folder,
                env=self.environment,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
                check=False,
            )
            code, printed = done.returncode, done.stdout + done.stderr
        assert code == 0, f"{where}: {line}\n{printed}"
        return printed

    def end(self) -> None:
        """Leave no process behind, whatever happened."""
        if self.terminal is not None:
            self.terminal.kill()
        for note in (self.folder / "lab" / "nodes").glob("*.json"):
            with contextlib.suppress(OSError, ValueError):
                os.kill(json.loads(note.read_text())["pid"], signal.SIGKILL)


@pytest.fixture
def operator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Operator]:
    for name in [name for name in os.environ if name.startswith("LABOS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("LABOS_USER", OPERATOR)
    monkeypatch.chdir(tmp_path)
    operator = Operator(tmp_path)
    operator.environment["LABOS_USER"] = OPERATOR
    yield operator
    operator.end()


@pytest.mark.timeout(180)
def test_a_shift_goes_as_the_page_says(operator: Operator) -> None:
    for block in blocks(PAGE.read_text()):
        operator.do(block)
    report = json.loads((operator.folder / "shift.json").read_text())
    assert [(run["run"], run["doing"]) for run in report["running"]] == [("R6", ["'dye' on operator"])]
    assert [run["status"] for run in report["ended"]] == ["completed"] * 6
    assert (report["twh"]["interventions"], report["twh"]["planned"]) == (3, 4)
    records = records_of(operator.folder)
    slow = [request.args["slow"] for request in transfers(records, "sealer.default")]
    expected = [True, True, False, False, False]
    assert slow == expected, f"a crawl until the arm has been there once:\n{print_actions(records)}"
    state = LabState()
    fold(state, records)
    world = World(str(operator.folder / "lab/world/corner.db"))
    try:
        assert list_differences(world, state, records) == []
    finally:
        world.close()


def records_of(folder: Path) -> list[Record]:
    store = open_store(f"sqlite:///{folder / 'lab/labos.db'}", create=False, read_only=True)
    try:
        return list(store.read())
    finally:
        store.close()


def print_actions(records: list[Record]) -> str:
    """The events of all actions and questions, a line each."""
    kept = [r for r in records if r.head.type.startswith(("action.", "intervention.", "node.", "step."))]
    return "\n".join(
        f"{r.head.position} {r.head.recorded_at} {r.head.type} {r.payload.decode()}" for r in kept
    )


def transfers(records: list[Record], target: str) -> list[ActionRequested]:
    """The requests for carrying a plate to a station."""
    found = [decode(r.head.type, r.head.schema, r.payload) for r in records if r.head.type == REQUESTED]
    return [e for e in found if isinstance(e, ActionRequested) and e.args.get("target") == target]
