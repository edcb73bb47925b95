"""The applications as processes of their users, in as many lives as it takes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from labos.client import LabClient
from labos.settings import TOKEN
from labos.spec.library import find_specs_folder
from tests.apps.together.bench import Bench

APPS = find_specs_folder() / "apps"
PATIENCE_S = 240.0
"""So long a program waits for a lab that is silent, before it has to be started again."""


class App(NamedTuple):
    """An application: its program, what its experiment is called, who starts it, in which workcell, and the
    words that it is started with. ``payload`` replaces parts of its packaged payload file."""

    name: str
    program: str
    experiment: str
    user: str
    cell: str
    words: tuple[str, ...] = ()
    packaged: str = ""
    payload: dict[str, Any] = {}


COLOR_PICKER = App(
    "color_picker",
    "color_picker/color_picker.py",
    "color picker",
    "bo",
    "rpl",
    ("--workcell", "rpl", "--seed", "3"),
    "color_picker/payloads/grey.yaml",
    {"samples": 60, "batch": 6, "close": 0.0, "bad_pictures": "leave_out"},
)
PCR = App(
    "pcr",
    "pcr/pcr.py",
    "pcr",
    "cy",
    "rpl",
    ("--workcell", "rpl"),
    "pcr/payloads/standard.yaml",
    {"plates": 3},
)
GROWTH_ASSAY = App(
    "growth_assay",
    "growth_assay/growth_assay.py",
    "growth assay",
    "bo",
    "bio",
    ("--workcell", "bio", "--plates", "4"),
)
POLYMERS = App(
    "polymers",
    "polymers/polymers.py",
    "electrochromic polymers",
    "di",
    "cnm",
    ("--seed", "1"),
    "polymers/payloads/blue.yaml",
    {"saturated": "thinner"},
)
PENDANT_DROP = App(
    "pendant_drop",
    "pendant_drop/pendant_drop.py",
    "pendant drop",
    "qi",
    "aps_8id",
    (),
    "pendant_drop/payloads/silica_50.yaml",
)
TWO_PICKERS = COLOR_PICKER._replace(
    cell="rpl_picker",
    words=("--seed", "3"),
    payload={
        **COLOR_PICKER.payload,
        "samples": 12,
        "batch": 4,
        "handlers": ["ot2_cp_gamma", "ot2_growth_beta"],
    },
)
"""The color picker with two liquid handlers, each with a plate of its own."""
FIVE = (COLOR_PICKER, PCR, GROWTH_ASSAY, POLYMERS, PENDANT_DROP)
"""Of four users: Bo has two of them."""


class Program:
    """One application that is to come to its end."""

    def __init__(self, bench: Bench, app: App) -> None:
        self.bench, self.app = bench, app
        self.out = bench.folder / "out" / app.name
        self.log = bench.folder / f"{app.name}.log"
        self.lives = 0
        self.experiments: list[str] = []
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Start it; with ``--resume``, if its experiment has begun."""
        argv = [sys.executable, str(APPS / self.app.program), "--home", str(self.bench.up.home)]
        argv += ["--user", self.app.user, "--out", str(self.out), "--patience", f"{PATIENCE_S:g}"]
        argv += [*self.app.words, *self._payload()]
        if self.lives and self.find():
            argv += ["--resume", self.experiments[0]]
        self.lives += 1
        token = {TOKEN: self.bench.tokens[self.app.user]}
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                argv, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env={**os.environ, **token}
            )

    def find(self) -> list[str]:
        """The ids of its experiments, as its user reads them in the log: the first is that of the program,
        the others are part of it. Empty if it has not begun."""
        with self.bench.client(self.app.user) as client:
            self.experiments = experiments_of(client, self.app)
        return self.experiments

    def kill(self) -> None:
        """kill -9."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def has_ended(self) -> bool:
        return self._process is not None and self._process.poll() is not None

    def is_done(self) -> bool:
        """Whether it has come to its end. Raises AssertionError if it has failed."""
        if not self.has_ended():
            return False
        assert self._process is not None
        assert self._process.returncode in (0, -signal.SIGKILL), f"{self.app.name}: {self.read_log()}"
        return self._process.returncode == 0

    def read_log(self) -> str:
        return self.log.read_text("utf-8", "replace")[-3000:] if self.log.exists() else ""

    def workers(self) -> list[int]:
        """The processes in which it computes."""
        return [pid for pid in children_of(self.pid) if b"spawn_main" in command_of(pid)]

    def _payload(self) -> Sequence[str]:
        if not self.app.packaged:
            return ()
        told = yaml.safe_load((APPS / self.app.packaged).read_text("utf-8"))
        file = self.bench.folder / "payloads" / f"{self.app.name}.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(yaml.safe_dump({**told, **self.app.payload}), "utf-8")
        return ("--payload", str(file))


def experiments_of(client: LabClient, app: App) -> list[str]:
    """The experiments of that name and user, and those that are called after it."""
    started = [event["payload"] for event in client.events(type="experiment.started")]
    return [
        str(told["experiment"])
        for told in started
        if told["name"].partition(", ")[0] == app.experiment and told["user"] == app.user
    ]


def children_of(parent: int) -> list[int]:
    try:
        text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
    except OSError:
        text = ""
    found = [int(word) for word in text.split()]
    return found or [pid for pid in _all_pids() if _parent_of(pid) == parent]


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def _all_pids() -> list[int]:
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdecimal()]


def _parent_of(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0
