"""A lab as its users start it: ``labos up`` and nodes, as processes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from labos.client import LabClient
from labos.errors import LabosError
from labos.settings import KernelInfo, find_kernel

T = TypeVar("T")
PATIENCE_S = 60.0


class LabProcess:
    """``labos up rpl --simulate`` until the block ends."""

    def __init__(self, home: Path, *options: str) -> None:
        self.home = home
        self._options = options
        self.nodes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> LabProcess:
        self.home.mkdir(parents=True, exist_ok=True)
        argv = [sys.executable, "-m", "labos", "up", "rpl", "--simulate", "--speed", "600", "--quiet"]
        with (self.home / "up.log").open("wb") as log:
            self.began_ns = time.time_ns()
            self.process = subprocess.Popen(
                [*argv, "--home", str(self.home), *self._options], stdout=log, stderr=log
            )
        return self

    def __exit__(self, *_: object) -> None:
        for node in self.nodes:
            node.terminate()
        self.process.send_signal(signal.SIGINT)
        for process in (self.process, *self.nodes):
            try:
                process.wait(40)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start_node(self, driver: str, name: str) -> None:
        argv = [sys.executable, "-m", "labos", "node", "start", driver, "--name", name, "--workcell", "rpl"]
        argv += ["--simulate", "--home", str(self.home), "--connect", self.info().bus]
        self.nodes.append(subprocess.Popen(argv, stderr=subprocess.DEVNULL))

    def info(self) -> KernelInfo:
        return self.until(lambda: find_kernel(self.home))

    def until(self, ask: Callable[[], T | None]) -> T:
        """What ``ask`` gives as soon as it gives something."""
        give_up = time.monotonic() + PATIENCE_S
        while time.monotonic() < give_up:
            if self.process.poll() is not None:
                break
            try:
                found = ask()
            except LabosError:
                found = None
            if found is not None:
                return found
            time.sleep(0.02)
        raise RuntimeError("the lab does not answer:\n" + (self.home / "up.log").read_text()[-3000:])

    def client(self) -> LabClient:
        self.info()
        return LabClient(home=self.home)

    def submit(self, client: LabClient, workflow: Any) -> str:
        return self.until(lambda: client.submit(workflow, {}, user="ada", request="first"))


def resident_mb(pid: int) -> tuple[float, float]:
    """(RSS, PSS) of a process in MB; PSS shares what is shared."""
    rss = pss = 0.0
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Rss:"):
            rss = int(line.split()[1]) / 1024
        elif line.startswith("Pss:"):
            pss = int(line.split()[1]) / 1024
    return rss, pss
