"""Foreign nodes from PyPI, unmodified, as processes in environments of their own.

``python tests/foreign/make.py`` makes the environments (CI does); a test that finds none skips.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, ClassVar, Self

import httpx
import pytest

from tests.foreign.make import FOLDER, MAVEN_PACKAGES, NODE_PACKAGES, PACKAGES, ROOT


def python_of(kind: str) -> Path:
    """The Python of a foreign kind's environment; ours, for a kind that needs no packages. Skips the test
    where there is none; where LABOS_REQUIRE_FOREIGN names it, waits while it is being made."""
    if kind not in PACKAGES:
        return Path(sys.executable)
    _await_complete(kind, PACKAGES[kind][0])
    return FOLDER / kind / "bin" / "python"


def _await_complete(kind: str, package: str) -> None:
    complete = FOLDER / kind / "complete"
    if kind in os.environ.get("LABOS_REQUIRE_FOREIGN", "").split():
        until = time.monotonic() + 90
        while not complete.exists():
            if time.monotonic() > until:
                pytest.fail(
                    f"LABOS_REQUIRE_FOREIGN is set, but there is no {complete}; see .foreign/make.log"
                )
            time.sleep(0.2)
    elif not complete.exists():
        pytest.skip(f"no environment with {package} (python tests/foreign/make.py {kind})")


def node_modules_of(kind: str) -> Path:
    """The folder of a foreign kind's packages of npm. Skips the test where there is none, or no ``node``;
    where LABOS_REQUIRE_FOREIGN names it, waits while it is being made."""
    _await_complete(kind, NODE_PACKAGES[kind][0])
    if shutil.which("node") is None:
        pytest.skip("no node")
    return FOLDER / kind / "node_modules"


def java_libraries_of(kind: str) -> Path:
    """The folder of a foreign kind's packages of Maven. Skips the test where there is none, or no ``java``;
    where LABOS_REQUIRE_FOREIGN names it, waits while it is being made."""
    _await_complete(kind, MAVEN_PACKAGES[kind][0])
    if shutil.which("java") is None:
        pytest.skip("no java")
    return FOLDER / kind / "libs"


def opentrons_simulate() -> str:
    """The program of Opentrons' own software: named by the environment, on the path, or made here. Skips the
    test where there is none."""
    named = os.environ.get("LABOS_OPENTRONS_SIMULATE") or shutil.which("opentrons_simulate")
    return named or str(python_of("opentrons").with_name("opentrons_simulate"))


class ForeignProcess:
    """One foreign node on loopback. It can be killed and started again on its port. ``says_up`` is what it
    prints when it is ready; empty for one that is asked over HTTP."""

    says_up: ClassVar[str] = ""

    def __init__(self, kind: str, folder: Path, port: int) -> None:
        self.kind, self.folder, self.port = kind, folder, port
        self.python = python_of(kind)
        folder.mkdir(parents=True, exist_ok=True)
        self.truth_file = folder / "truth.jsonl"
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def interface(self) -> str:
        return f"{self.kind}_rest_node"

    def command(self) -> list[Path | str]:
        """The program, in the foreign environment."""
        options = ["--host", "127.0.0.1", "--port", str(self.port)] if self.kind == "wei" else []
        return [self.python, ROOT / "tests" / "foreign" / f"{self.kind}_node.py", *options]

    def environment(self) -> dict[str, str]:
        return {"NODE_URL": self.url, "NODE_NAME": "bench", "OTEL_ENABLED": "false"}

    def start(self) -> Self:
        """Start it, and wait until it is ready."""
        if self.says_up:
            (self.folder / "node.log").unlink(missing_ok=True)
        with (self.folder / "node.log").open("ab") as log:
            self.process = subprocess.Popen(
                self.command(),
                cwd=self.folder,
                env={**os.environ, "TRUTH": str(self.truth_file), **self.environment()},
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
            )
        until = time.monotonic() + 60
        while not self._ready():
            if self.process.poll() is not None or time.monotonic() > until:
                self.kill()
                raise AssertionError((self.folder / "node.log").read_text()[-3000:])
            time.sleep(0.05)
        return self

    def _ready(self) -> bool:
        if self.says_up:
            return self.says_up in (self.folder / "node.log").read_text()
        try:
            path = "/state" if self.kind == "wei" else "/status"
            told = httpx.get(self.url + path, timeout=5.0, trust_env=False).json()
        except (httpx.HTTPError, ValueError):
            return False
        return bool(told["status"].get("READY") if self.kind == "wei" else told.get("ready"))

    def send(self, signal: int) -> None:
        """Freeze it, or let it go on."""
        assert self.process is not None
        self.process.send_signal(signal)

    def kill(self) -> None:
        """kill -9."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def truth(self, what: str = "", **fields: Any) -> list[dict[str, Any]]:
        """What it really did."""
        if not self.truth_file.exists():
            return []
        lines = [json.loads(line) for line in self.truth_file.read_text().splitlines()]
        return [
            line
            for line in lines
            if (not what or line["what"] == what) and all(line.get(k) == v for k, v in fields.items())
        ]
