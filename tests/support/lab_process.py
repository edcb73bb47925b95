"""``labos up`` as a process of its own, and what is true after it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from labos.client import LabClient
from labos.core.envelope import Record
from labos.core.state import LabState
from labos.node.world import Motion, World
from labos.runtime.ledger import fold
from labos.services.truth import list_differences
from labos.settings import Settings, find_kernel
from labos.store import open_store
from tests.support.cells import rpl_with

PATIENCE_S = 60.0


def labos(*argv: str, timeout_s: float = PATIENCE_S, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    command = [sys.executable, "-m", "labos", *argv]
    bare = {k: v for k, v in os.environ.items() if not k.startswith("LABOS_") or k == "LABOS_CORPUS"}
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        env={**bare, **environment},
        check=False,
        stdin=subprocess.DEVNULL,
    )


def until(holds: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    """Look until something holds; returns what it is."""
    give_up = time.monotonic() + patience_s
    while time.monotonic() < give_up:
        found = holds()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"not within {patience_s:g} s: {what}")


class Up:
    """A lab in the foreground of somebody's terminal."""

    def __init__(self, home: Path, *options: str) -> None:
        self.home = home
        self.options = options
        self.environment: dict[str, str] = {}
        self.process: subprocess.Popen[bytes] | None = None
        self.stdout: int | None = None
        """Where its output goes, instead of ``up.log``."""

    def start(self, *workcells: str) -> Up:
        """Start it and wait until it can be talked to. One that does not come so far is killed."""
        self.launch(*workcells)
        try:
            until(lambda: self.is_there() or self.process.poll() is not None, "the lab answers")  # type: ignore[union-attr]
            assert self.is_there(), self.read_log()
        except BaseException:
            self.clean_up()
            raise
        return self

    def start_with(self, *modules: str) -> Up:
        """Start it with these modules of the paper's workcell only: each has a process."""
        return self.start(str(rpl_with(modules, self.home.with_suffix(".yaml"))))

    def launch(self, *workcells: str) -> None:
        """Start it and do not wait."""
        argv = [sys.executable, "-m", "labos", "up", *workcells, "--home", str(self.home), *self.options]
        self.home.mkdir(parents=True, exist_ok=True)
        with (self.home / "up.log").open("ab") as log:
            self.process = subprocess.Popen(
                argv,
                stdout=log if self.stdout is None else self.stdout,
                stderr=log,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **self.environment},
            )

    def is_there(self) -> bool:
        found = find_kernel(self.home)
        return found is not None and self.process is not None and found.pid == self.process.pid

    def read_log(self) -> str:
        return (self.home / "up.log").read_text()[-3000:]

    def client(self) -> LabClient:
        return LabClient(home=self.home)

    def interrupt(self) -> int:
        """Ctrl-C; returns the exit code."""
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE_S)

    def kill(self) -> None:
        """kill -9."""
        assert self.process is not None
        self.process.kill()
        self.process.wait(PATIENCE_S)

    def clean_up(self) -> None:
        """Leave no process behind, whatever happened."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        for note in (self.home / "nodes").glob("*.json"):
            with contextlib.suppress(OSError, ValueError):
                os.kill(json.loads(note.read_text())["pid"], signal.SIGKILL)

    # -- afterwards --------------------------------------------------------------------------

    def records(self) -> list[Record]:
        store = open_store(Settings.make(self.home).database, create=False, read_only=True)
        try:
            return list(store.read())
        finally:
            store.close()

    def types(self) -> list[str]:
        return [record.head.type for record in self.records()]

    def bench(self) -> dict[str, list[str]]:
        """Every place of the simulated bench that holds plates."""
        world = World(str(self.home / "world" / "rpl.db"))
        try:
            return world.list_contents()
        finally:
            world.close()

    def motions(self, verb: str) -> list[Motion]:
        """What the simulated devices did, by their own account."""
        world = World(str(self.home / "world" / "rpl.db"))
        try:
            return world.motions(verb)
        finally:
            world.close()

    def disagreements(self) -> list[str]:
        """Where the bench and the log differ."""
        state = LabState()
        records = self.records()
        fold(state, records)
        world = World(str(self.home / "world" / "rpl.db"))
        try:
            return list_differences(world, state, records)
        finally:
            world.close()


def statuses(client: LabClient, runs: Sequence[str]) -> list[str]:
    """How runs ended, when they have all ended."""
    return [client.wait(run, timeout_s=PATIENCE_S).status for run in runs]
