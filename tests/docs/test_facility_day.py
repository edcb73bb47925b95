"""The page of a facility's day: each command is carried out by whoever it belongs to, and says what the page
says."""

from __future__ import annotations

import io
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.settings import Settings
from labos.spec import load_workcell
from tests.docs.markdown import DOCS, Block, blocks
from tests.docs.test_tutorial import check_output
from tests.support.cells import rpl_with

PAGE = DOCS / "facility-day.md"
PATIENCE_S = 60.0


class Day:
    """Does what the page says, each as whoever types it: with a configuration of their own."""

    def __init__(
        self, folder: Path, lab: LabThread, patch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        self.folder, self.lab, self.patch, self.capsys = folder, lab, patch, capsys
        self.tokens: dict[str, str] = {}
        self.said = ""

    def do(self, block: Block) -> None:
        where = f"{PAGE.name}:{block.line}"
        told = block.attributes
        if block.title:
            (self.folder / block.title).write_text(block.text)
        elif block.language == "text":
            check_output(block.text, self.said, where)
        elif block.language == "bash":
            self.be(told.get("who", ""))
            give_up = time.monotonic() + PATIENCE_S
            while True:
                for line in block.text.splitlines():
                    code, self.said = self.type(line, told.get("types", ""))
                    assert code == int(told.get("fails", 0)), f"{where}: {line}: {code}\n{self.said}"
                if told.get("until", "") in " ".join(self.said.split()):
                    break
                assert time.monotonic() < give_up, f"{where}: not within {PATIENCE_S:g} s:\n{self.said}"
            if "keeps" in told:
                words = self.said.split()
                self.tokens[told["keeps"]] = next(word for word in words if word.startswith("labos_token_"))

    def be(self, who: str) -> None:
        """Sit down at somebody's computer; nobody's name is that of the lab's own."""
        for name in ("LABOS_URL", "LABOS_TOKEN", "LABOS_USER"):
            self.patch.delenv(name, raising=False)
        self.patch.setenv("XDG_CONFIG_HOME", str(self.folder / "computers" / who))
        if who:
            self.patch.setenv("LABOS_URL", self.lab.url)
        if who in self.tokens:
            self.patch.setenv("LABOS_TOKEN", self.tokens[who])

    def type(self, line: str, types: str) -> tuple[int, str]:
        self.patch.setattr("sys.stdin", io.StringIO(f"{types}\n"))
        code = main(shlex.split(line)[1:])
        printed = self.capsys.readouterr()
        return code, printed.out + printed.err


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[LabThread]:
    settings = Settings.make(tmp_path / "lab", speed=400.0, simulate=True)
    cell = load_workcell(rpl_with(("sciclops", "pf400", "sealer"), tmp_path / "rpl.yaml"), descriptions())
    with LabThread(settings, [cell]) as running:
        yield running


@pytest.mark.slow
def test_the_day_goes_as_the_page_tells(
    tmp_path: Path,
    lab: LabThread,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    day = Day(tmp_path, lab, monkeypatch, capsys)
    for block in blocks(PAGE.read_text()):
        day.do(block)
