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
from tests.integration.torture.planted import BUGS, SHAKER, plant
from tests.support.lab_process import labos

MOTION_S = 0.6


async def run_torture(path: Path, *only: str) -> dict[str, Finding]:
    report = await torture(str(path), only=only, motion_s=MOTION_S)
    return {finding.check: finding for finding in report.findings}


FEW = (
    *("says that nothing moved", "tells another level", "blocks the loop"),
    "takes a restart for the end after a long wait",
)
"""Four of them are enough for every day."""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_is_wrong_is_found(tmp_path: Path) -> None:
    assert find_missed(FEW, tmp_path) == {}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_a_device_notes_when_its_power_goes_is_no_end_of_its_motion(tmp_path: Path) -> None:
    good = "    def fail(self, state: str) -> None:\n"
    notes = (
        "    def close(self) -> None:\n"
        "        super().close()\n"
        '        if self.state == "BUSY":\n'
        "            self._end_shake(900.0, 50.0)\n\n"
    )
    text = SHAKER.read_text()
    assert text.count(good) == 1
    path = tmp_path / "shaker_that_notes.py"
    path.write_text(text.replace(good, notes + good))
    finding = asyncio.run(run_torture(path, "power cycle"))["power cycle"]
    assert (finding.verdict, finding.why) == ("passed", "")


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_every_kind_of_bug_is_found(tmp_path: Path) -> None:
    assert len(BUGS) >= 36
    assert find_missed(list(BUGS), tmp_path) == {}


def find_missed(names: Sequence[str], folder: Path) -> dict[str, str]:
    """Of these bugs, those that the suite does not find, with what it says in their place."""
    turns = asyncio.Semaphore(4)

    async def one(name: str) -> Finding:
        async with turns:
            return (await run_torture(plant(folder, name), BUGS[name].check))[BUGS[name].check]

    async def main() -> list[Finding]:
        return await asyncio.gather(*map(one, names))

    found = zip(names, asyncio.run(main()), strict=True)
    return {
        name: f"{finding.verdict}: {finding.why}"
        for name, finding in found
        if finding.verdict != "failed" or BUGS[name].says not in finding.why
    }


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
    assert report.limits == "only some checks were requested"
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
    findings = asyncio.run(run_torture(path, "stop"))
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


@pytest.mark.slow
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
