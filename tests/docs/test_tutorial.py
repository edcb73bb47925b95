"""The tutorial, done from its first line to its last: its files, its commands, what they print."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tomllib
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.markdown import DOCS, REFERENCE, Block, blocks, first_codes

TUTORIAL = DOCS / "tutorial-first-instrument.md"
MOST_LINES, MOST_LINES_WITH_DEVICE = 30, 60
FEW_CHECKS = ("happy path", "device error")
"""The whole of the torture takes a minute."""

VARYING = (
    (re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+[+-]\d\d:\d\d"), "<time>"),
    (re.compile(r"\b\d+(\.\d+)? (s|min)\b"), "<span>"),
    (re.compile(r"[0-9a-f]{8}-[0-9a-f-]{27}"), "<id>"),
    (re.compile(r"127\.0\.0\.1:\d+"), "<address>"),
    (re.compile(r"^ *\d+ +<time>"), "<position> <time>"),
    (re.compile(r"event \d+"), "event <position>"),
    (re.compile(r"\b\d{3,7}$"), "<pid>"),
    (re.compile(r" +"), " "),
)


def steady(line: str) -> str:
    """A line without what differs from run to run."""
    for pattern, name in VARYING:
        line = pattern.sub(name, line.rstrip())
    return line.strip()


def pattern_of(line: str) -> re.Pattern[str]:
    """A line of the tutorial as a pattern; ``…`` stands for anything."""
    return re.compile(".*".join(re.escape(steady(part)) for part in line.split("…")))


def check_output(expected: str, printed: str, where: str) -> None:
    """The lines of the tutorial were printed, in order; a line ``…`` stands for any lines."""
    wanted = deque(line for line in expected.splitlines() if line.strip())
    skipping = False
    for line in (line for line in printed.splitlines() if line.strip()):
        if wanted and wanted[0].strip() == "…":
            skipping = True
            wanted.popleft()
        if wanted and pattern_of(wanted[0]).fullmatch(steady(line)):
            wanted.popleft()
            skipping = False
        else:
            assert skipping, f"{where}: the page does not tell of {line!r}\n{printed}"
    assert not [line for line in wanted if line != "…"], f"{where}: not printed: {wanted[0]!r}\n{printed}"


class Terminal:
    """One terminal of the reader, in which a lab runs."""

    def __init__(self, command: str, folder: Path, environment: dict[str, str]) -> None:
        self.lines: list[str] = []
        self._busy: dict[str, str] = {}
        self._process = subprocess.Popen(
            command.split(),
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            # A shell that runs the tests in the background has Ctrl-C ignored.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )

    def read_until(self, expected: str) -> None:
        """Read until all these lines were printed, in whatever order. Raises AssertionError."""
        wanted = [pattern_of(line) for line in expected.splitlines() if line.strip()]
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append(line)
            said = self._wait_until_settled(steady(line))
            wanted = [pattern for pattern in wanted if not pattern.fullmatch(said)]
            if not wanted:
                return
        raise AssertionError(f"not printed: {wanted[0].pattern}\n{''.join(self.lines)}")

    def _wait_until_settled(self, line: str) -> str:
        """A node that joins while it still connects is ready when it says IDLE."""
        joined = re.fullmatch(r"(<time> \S+): (node joined \(.*\)), BUSY", line)
        if joined:
            self._busy[f"{joined[1]}: IDLE"] = f"{joined[1]}: {joined[2]}, IDLE"
        return self._busy.get(line, line)

    def press_ctrl_c(self) -> None:
        self._process.send_signal(signal.SIGINT)

    def has_ended(self) -> int:
        """Its exit code, when it ends; its output is read meanwhile."""
        printed, _ = self._process.communicate(timeout=30)
        self.lines.append(printed)
        return self._process.returncode

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()


class Reader:
    """Does what the page says."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("LABOS_")},
            **{"PYTHONPATH": str(folder), "PATH": path, "LABOS_USER": "ada", "COLUMNS": "200"},
        }
        self.terminal: Terminal | None = None
        self.said = ""

    def do(self, block: Block) -> None:
        where = f"{TUTORIAL.name}:{block.line}"
        if block.title:
            (self.folder / block.title).write_text(block.text)
        elif block.attributes.get("after") == "Ctrl-C":
            assert self.terminal is not None
            self.terminal.press_ctrl_c()
            self.terminal.read_until(block.text)
            assert self.terminal.has_ended() == 0
        elif "terminal" in block.attributes:
            if block.language == "bash":
                self.terminal = Terminal(block.text, self.folder, self.environment)
            else:
                assert self.terminal is not None
                self.terminal.read_until(block.text)
        elif block.text == "pip install -e .\n":
            self.install()
        elif block.language == "bash":
            self.said = self.run(block, where)
        else:
            check_output(block.text, self.said, where)

    def install(self) -> None:
        """What pip would leave of the package for importlib.metadata, without its seconds."""
        told = tomllib.loads((self.folder / "pyproject.toml").read_text())["project"]
        info = self.folder / f"{told['name'].replace('-', '_')}-{told['version']}.dist-info"
        info.mkdir()
        info.joinpath("METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {told['name']}\nVersion: {told['version']}\n"
        )
        lines = [
            line
            for group, entries in told["entry-points"].items()
            for line in (f"[{group}]", *(f"{name} = {target}" for name, target in entries.items()))
        ]
        info.joinpath("entry_points.txt").write_text("\n".join(lines) + "\n")

    def run(self, block: Block, where: str) -> str:
        done = subprocess.run(
            ["bash", "-ec", block.text],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        wanted = int(block.attributes.get("exit", "0"))
        assert done.returncode == wanted, f"{where}: {done.stdout}{done.stderr}"
        return done.stdout + done.stderr


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    reader = Reader(tmp_path)
    yield reader
    if reader.terminal is not None:
        reader.terminal.kill()


@pytest.mark.timeout(180)
@pytest.mark.slow
def test_the_tutorial_does_what_it_says(reader: Reader) -> None:
    for block in blocks(TUTORIAL.read_text()):
        if "full" not in block.attributes:
            reader.do(block)
    left = {path.name for path in (reader.folder / "lab").iterdir()}
    told = {name.rstrip("/") for name in first_codes((REFERENCE / "settings.md").read_text())}
    assert {name for name in left if not name.startswith(".")} <= told
    assert (reader.folder / "lab/journals/corner.shaker.journal").is_file()


def test_the_driver_is_as_short_as_is_claimed() -> None:
    driver = _block("our_shaker.py")
    assert len([line for line in driver.splitlines() if line.strip()]) <= MOST_LINES
    assert max(map(len, driver.splitlines())) <= 110


def test_the_real_driver_is_as_short_as_is_claimed() -> None:
    driver = _block("our_real_shaker.py")
    assert len([line for line in driver.splitlines() if line.strip()]) < MOST_LINES_WITH_DEVICE
    assert max(map(len, driver.splitlines())) <= 110


@pytest.mark.timeout(90)
@pytest.mark.slow
def test_the_real_driver_drives_its_device(reader: Reader) -> None:
    block = _find_block("our_real_shaker.py")
    reader.do(block)
    for part in FEW_CHECKS:
        assert part in _block_of_output()
    checks = " ".join(f'--check "{check}"' for check in FEW_CHECKS)
    torture = f"labos driver torture {block.title} --motion-s 0.6 {checks}"
    said = reader.run(Block("bash", {}, torture, block.line), block.title)
    assert all(f"{check:18}  ok" in said for check in FEW_CHECKS), said


@pytest.mark.full
@pytest.mark.timeout(600)
def test_the_real_driver_gets_the_badge_that_is_told(reader: Reader) -> None:
    reader.do(_find_block("our_real_shaker.py"))
    for block in blocks(TUTORIAL.read_text()):
        if "full" in block.attributes:
            reader.do(Block(block.language, {}, block.text, block.line))


def _block_of_output() -> str:
    return next(
        b.text for b in blocks(TUTORIAL.read_text()) if b.language == "text" and "full" in b.attributes
    )


def _find_block(title: str) -> Block:
    return next(block for block in blocks(TUTORIAL.read_text()) if block.title == title)


def _block(title: str) -> str:
    return _find_block(title).text
