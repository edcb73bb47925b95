"""What others make of the description of the API: a tester that asks all it allows, and a client that a stock
generator makes from it.

``python tests/foreign/make.py schemathesis`` makes their environment; without it these tests are skipped.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from labos.bootstrap import ApiSettings, LabThread, descriptions
from labos.client import LabClient
from labos.http.routes import OPERATIONS, PREFIX
from labos.settings import Settings
from labos.spec import parse_workcell
from tests.foreign.make import ROOT
from tests.integration.http.test_fuzz import CELL, expect_normal
from tests.support.api_process import ApiThread
from tests.support.foreign import python_of

CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_schema_conformance",
    "response_headers_conformance",
)
ENDLESS = f"{PREFIX}/events/stream"


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[LabThread]:
    cell = parse_workcell(CELL.format(name="fuzz"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="processes") as running:
        yield running


def ask_everything(url: str, folder: Path, seed: int, examples: int, phases: str) -> int:
    """Let Schemathesis ask every operation but the endless one; returns how many requests it made."""
    program = python_of("schemathesis").with_name("schemathesis")
    done = subprocess.run(
        [
            *(program, "run", f"{url}{PREFIX}/openapi.json", "--seed", str(seed)),
            *("--max-examples", str(examples), "--checks", ",".join(CHECKS), "--exclude-path", ENDLESS),
            *("--phases", phases, "--generation-database", "none", "--no-color"),
            *("--request-timeout", "70", "--warnings", "off"),
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    told = "\n".join(line[:500] for line in done.stdout.splitlines()[-150:])
    assert done.returncode == 0, told + done.stderr[-2000:]
    asked = re.search(rf"Tested: {len(OPERATIONS) - 1}\n(?s:.*?)(\d+) generated, (\d+) passed", done.stdout)
    assert asked, told
    assert asked[1] == asked[2]
    return int(asked[1])


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nothing_is_answered_that_is_not_described(lab: LabThread, tmp_path: Path) -> None:
    assert ask_everything(lab.url, tmp_path, 1, 2, "examples,fuzzing") > 80
    expect_normal(lab, "afterwards")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nor_by_an_api_process(lab: LabThread, tmp_path: Path) -> None:
    with ApiThread(ApiSettings(Settings.make(tmp_path / "lab"))) as api:
        assert ask_everything(api.url, tmp_path, 1, 1, "examples,fuzzing") > 40
    expect_normal(lab, "afterwards")


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(2, 5))
def test_nothing_is_answered_that_is_not_described_to_many_requests(
    lab: LabThread, tmp_path: Path, seed: int
) -> None:
    assert ask_everything(lab.url, tmp_path, seed, 100, "examples,coverage,fuzzing") > 3000
    expect_normal(lab, "afterwards")


@pytest.mark.slow
def test_a_generated_client_runs_a_workflow(lab: LabThread, tmp_path: Path) -> None:
    python = python_of("schemathesis")
    described = tmp_path / "openapi.json"
    described.write_bytes(httpx.get(f"{lab.url}{PREFIX}/openapi.json").content)
    path = f"{python.parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(
        [
            *(python.with_name("openapi-python-client"), "generate", "--path", described),
            *("--output-path", tmp_path / "generated", "--fail-on-warning"),
        ],
        env={**os.environ, "PATH": path},
        capture_output=True,
        check=True,
    )
    done = subprocess.run(
        [python, ROOT / "tests" / "foreign" / "generated_client.py", lab.url, tmp_path / "generated"],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    told = json.loads(done.stdout)
    assert (told["status"], told["steps"]) == ("completed", ["done"])
    assert told["events"] == ["run.submitted", "run.started", "run.completed"]
    assert (told["problem"], told["finding"]) == ([404, "not_found"], [422, 1])
    assert told["modules"] == ["fuzz/arm", "fuzz/sealer", "fuzz/stacker"]
    with LabClient(lab.url) as client:
        assert client.status(told["run"]).succeeded
