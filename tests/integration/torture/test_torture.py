"""The torture suite finds what is wrong with a driver: each fault that is built into a good one."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest

from labos.bootstrap import load_driver
from labos.errors import BadInput
from labos.torture import CHECKS, Finding, Report, torture
from labos.torture.report import badge_of
from tests.support.lab_process import labos

SHAKER = Path(__file__).with_name("shaker.py")
MOTION_S = 0.6

POLL = 'while (state := self.ask("STAT")) == "BUSY":'

FAULTS: dict[str, tuple[str, str, str, str]] = {
    "says that nothing moved": (
        "unplugged during",
        "        with under_way():\n",
        "        with contextlib.ExitStack() as end:\n"
        '            end.push(lambda kind, error, where: error and setattr(error, "effects", "none"))\n',
        "nothing was done",
    ),
    "does not wait for the end": (
        "happy path",
        f"with under_way():\n            {POLL}",
        f"while False:\n            {POLL}",
        "says that it is done, but its device goes on",
    ),
    "is always idle": (
        "node killed",
        'self.ask, "STAT") == "IDLE"',
        'self.ask, "STAT") != ""',
        "ready for new",
    ),
    "does not stop": ("stop", 'self.ask, "HALT") != "OK"', 'self.ask, "STAT") == ""', "went on to its end"),
    "has no unit": ("about", 'unit="rpm", ', "", "has no unit"),
    "uses twice as much": ("happy path", 'self.name, "grease", 1)', 'self.name, "grease", 2)', "it used 2"),
    "tells another level": ("true state", 'self.ask, "GREASE"))', 'self.ask, "GREASE")) + 50', "there are"),
    "blocks the loop": (
        "event loop",
        '        return await asyncio.to_thread(self.ask, "STAT") == "IDLE"',
        '        time.sleep(0.3)\n        return await asyncio.to_thread(self.ask, "STAT") == "IDLE"',
        "is_idle",
    ),
    "believes that all went well": (
        "power cut",
        "    async def stop(self) -> None:\n",
        "    async def take_up(self, name: str, handle: str) -> None:\n        return None\n\n"
        "    async def stop(self) -> None:\n",
        "says that all was done",
    ),
    "shakes again when nobody answers": (
        "lost reply",
        '        if answer == "LOCKED":',
        '        if answer == "LOST":\n'
        '            while self.ask("STAT") == "BUSY":\n'
        "                time.sleep(0.02)\n"
        '            answer = self.ask(f"SHAKE {speed:.0f}")\n'
        '        if answer == "LOCKED":',
        "should have done",
    ),
    "takes noise for a refusal": (
        "garbled reply",
        'if answer == "LOCKED":',
        'if answer != "OK":',
        "nothing was",
    ),
}
"""By what is wrong: which check finds it, what is replaced by what, and a part of what is found."""


def broken(folder: Path, name: str) -> Path:
    """The shaker with one fault."""
    _, good, bad, _ = FAULTS[name]
    text = SHAKER.read_text()
    assert text.count(good) == 1, good
    text = text.replace(good, bad).replace("import asyncio\n", "import asyncio\nimport contextlib\n")
    if "LOST" in bad:
        text = text.replace(
            "        return self.line.exchange(question.encode(), ANSWER_S).decode",
            "        try:\n"
            "            said = self.line.exchange(question.encode(), ANSWER_S)\n"
            "        except NoReply:\n"
            '            return "LOST"\n'
            "        return said.decode",
        ).replace("from labos.node import (", "from labos.errors import NoReply\nfrom labos.node import (")
    path = folder / f"shaker_{list(FAULTS).index(name)}.py"
    path.write_text(text)
    return path


async def tortured(path: Path, *only: str) -> dict[str, Finding]:
    report = await torture(str(path), only=only, motion_s=MOTION_S)
    return {finding.check: finding for finding in report.findings}


FEW = ("says that nothing moved", "tells another level", "does not stop", "blocks the loop")
"""Four of them are enough for every day."""


@pytest.mark.parametrize(
    "names", [FEW, pytest.param([name for name in FAULTS if name not in FEW], marks=pytest.mark.full)]
)
@pytest.mark.timeout(300)
@pytest.mark.slow
def test_what_is_wrong_is_found(names: Sequence[str], tmp_path: Path) -> None:
    async def main() -> dict[str, Finding]:
        reports = [tortured(broken(tmp_path, name), FAULTS[name][0]) for name in names]
        found = await asyncio.gather(*reports)
        return {name: findings[FAULTS[name][0]] for name, findings in zip(names, found, strict=True)}

    for name, finding in asyncio.run(main()).items():
        assert finding.verdict == "failed", name
        assert FAULTS[name][3] in finding.why, (name, finding.why)


@pytest.mark.timeout(120)
def test_a_good_driver_passes_and_is_told_so_in_json(tmp_path: Path) -> None:
    checks = ("about",)
    named = [word for check in checks for word in ("--check", check)]
    done = labos(
        *("driver", "torture", str(SHAKER), *named, "--motion-s", str(MOTION_S), "--json"),
        *("--keep", str(tmp_path / "kept")),
        timeout_s=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    report = msgspec.json.decode(done.stdout.encode(), type=Report)
    assert {
        f.check: f.verdict for f in report.findings if f.check in (*checks, "happy path")
    } == dict.fromkeys(("about", "happy path"), "passed")
    assert report.limits == "only some checks were asked for"
    assert (tmp_path / "kept" / "journals").is_dir()


LATE = """
met = []


def at_its_end(shaker: Any, world: World) -> bool:
    met.append(shaker.state)
    return met[-2:] == ["BUSY", "IDLE"]


def in_its_middle(shaker: Any, world: World) -> bool:
    return shaker.state == "BUSY"
"""


@pytest.mark.timeout(180)
@pytest.mark.slow
def test_a_motion_that_is_over_too_soon_is_begun_again(tmp_path: Path) -> None:
    text = SHAKER.read_text().replace("TORTURE = Torture(\n", f"{LATE}\n\nTORTURE = Torture(\n")
    text = text.replace("cases=", "moments=(at_its_end, in_its_middle), cases=")
    # Its node says for a while yet that it shakes.
    text = text.replace('if state != "IDLE"', 'time.sleep(0.5)\n            if state != "IDLE"')
    path = tmp_path / "shaker_interrupted_late.py"
    path.write_text(text)
    findings = asyncio.run(tortured(path, "stop"))
    assert findings["stop"].verdict == "passed", findings["stop"].why


@pytest.mark.full
@pytest.mark.parametrize("line", ["serial", "tcp"])
@pytest.mark.timeout(600)
def test_a_good_driver_survives_everything(line: str, tmp_path: Path) -> None:
    text = SHAKER.read_text()
    if line == "tcp":
        text = text.replace("device=ShakerOnLine", "device=lambda setup: ShakerOnLine(setup, TcpEnd())")
        text = text.replace("FarEnd,", "FarEnd, TcpEnd,", 1)
    path = tmp_path / f"shaker_on_{line}.py"
    path.write_text(text)
    report = asyncio.run(torture(str(path), motion_s=MOTION_S))
    assert [f for f in report.findings if f.verdict == "failed"] == []
    assert (report.badge, report.evidence) == ("silver", ("self-simulated, behind a real wire",))


def test_a_badge_needs_every_check_of_its_tier_and_below() -> None:
    passed = [Finding(name, tier, "passed") for name, (tier, _) in CHECKS.items()]
    assert badge_of(passed) == ("gold", "")
    for missing, badge in (("busy", "none"), ("stop", "bronze"), ("reconciles", "silver")):
        short = [
            Finding(f.check, f.tier, "left out", "there is none") if f.check == missing else f for f in passed
        ]
        assert badge_of(short) == (badge, "there is none")
    failed = [Finding(f.check, f.tier, "failed", "no") if f.check == "stop" else f for f in passed]
    assert badge_of(failed) == ("bronze", "stop: no")


@pytest.mark.parametrize(
    ("driver", "says"),
    [
        ("no_such_driver", "There is no driver 'no_such_driver'"),
        ("no_such_file.py", "There is no file no_such_file.py"),
        (f"{SHAKER}:Nobody", "holds no driver Nobody"),
    ],
)
def test_who_names_no_driver_is_told_so(driver: str, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        load_driver(driver)


@pytest.mark.timeout(180)
def test_a_new_driver_is_installed_and_survives_what_it_is_put_to(tmp_path: Path) -> None:
    python = new_environment(tmp_path)
    checks = ("about", "unplugged before")
    named = [word for check in checks for word in ("--check", check)]
    done = run(
        python, "-m", "labos", "driver", "torture", "tea_stirrer", *named, "--motion-s", "0.6", "--json"
    )
    report = json.loads(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [f["verdict"] for f in report["findings"] if f["check"] in checks] == ["passed"] * 2


@pytest.mark.full
@pytest.mark.timeout(600)
def test_a_new_driver_passes_its_own_tests_and_gets_its_badge(tmp_path: Path) -> None:
    python = new_environment(tmp_path)
    tested = run(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path / "tea_stirrer/tests"))
    assert tested.returncode == 0, tested.stdout + tested.stderr
    done = run(python, "-m", "labos", "driver", "torture", "tea_stirrer", "--at-least", "silver")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "tea_stirrer 1: silver (survives)" in done.stdout


def new_environment(folder: Path) -> Path:
    """An environment with a new driver in it; what else is needed it finds in this one, without a network."""
    assert labos("driver", "new", str(folder / "tea_stirrer")).returncode == 0
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "env")], check=True)
    python = folder / "env/bin/python"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    here = [path for path in sys.path if path.endswith("site-packages")]
    added = "".join(f"import site; site.addsitedir({path!r})\n" for path in here)
    (folder / f"env/lib/{version}/site-packages/here.pth").write_text(added)
    offline = ("--no-index", "--no-deps", "--no-build-isolation")
    done = run(python, "-m", "pip", "install", "-q", *offline, str(folder / "tea_stirrer"))
    assert done.returncode == 0, done.stdout + done.stderr
    return python


def run(python: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [str(python), *words],
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
        env=environment,
        cwd=python.parent,
    )
