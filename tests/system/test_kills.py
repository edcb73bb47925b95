"""kill -9 of the kernel and of the moving node at each labelled point, on both databases.

Two PCRs run on real processes; afterwards the bench and the log agree in every plate, nothing
happened twice, and the runs have ended (where a node died in motion, after a person looked).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.client import LabClient
from labos.core.ids import local
from labos.core.state import LabState
from labos.errors import LabosError
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.services.truth import list_differences
from labos.settings import find_kernel
from labos.spec import find_spec
from labos.store import open_store
from labos.testing.person import look
from tests.support.cells import PCR, rpl_with

KERNEL_POINTS = (
    "before_commit",
    "after_commit",
    "before_result_commit",
    "after_result_commit",
    "before_send",
    "after_send",
)
NODE_POINTS = (
    "before_accept_journal",
    "torn_accept_journal",
    "after_accept_journal",
    "before_grip",
    "in_motion",
    "before_result_journal",
    "torn_result_journal",
    "after_result_journal",
    "before_publish",
    "after_publish",
)
ONCE = [f"node.{when}_other_journal:1" for when in ("before", "torn", "after")]
"""Most acknowledgements are written along with something else."""
NOT_SENT, UNDER_WAY = "kernel.before_send_pf400:2", "kernel.after_send_pf400:2"
ASK_OR_VOID = [
    f"{first},node.{when}_{line}_journal:1"
    for first, line in ((NOT_SENT, "void"), (UNDER_WAY, "epoch"))
    for when in ("before", "torn", "after")
]
"""The kernel dies before it sends, or while the arm moves; the arm's node, when the next one asks."""
RECOVERY = [
    "kernel.after_commit:11,kernel.after_claim:1",
    "kernel.after_commit:11,kernel.before_commit:1",
    "kernel.after_commit:11,kernel.after_commit:1",
    *(
        f"{first},kernel.{when}_ask_pf400:1"
        for first in (NOT_SENT, UNDER_WAY)
        for when in ("before", "after")
    ),
    f"{NOT_SENT},kernel.before_send_pf400:1",
    f"{UNDER_WAY},kernel.before_result_commit:1",
    *(f"node.in_motion:1,kernel.{point}:1" for point in ("before_look", "after_look", "after_sight")),
]
"""A kernel dies in the midst of making good for a crash: of the one before it, or of a node."""
CHAINS = [*ASK_OR_VOID, *RECOVERY, f"{NOT_SENT},kernel.after_ask_pf400:1,node.torn_accept_journal:1"]
POINTS = [f"kernel.{point}:{visit}" for point in KERNEL_POINTS for visit in (4, 11)] + [
    f"node.{point}:{visit}" for point in NODE_POINTS for visit in (1, 4)
]
POINTS += ONCE
SMOKE = ["kernel.after_commit:11", "node.in_motion:1", "node.torn_accept_journal:4"]
MAY_ASK = (
    "node.after_accept_journal",
    "node.before_grip",
    "node.in_motion",
    "node.before_result_journal",
    "node.torn_result_journal",
    "node.before_publish",
    "node.after_publish",
    "node.before_other_journal",
    "node.torn_other_journal",
    "node.after_other_journal",
    "node.before_epoch_journal",
    "node.torn_epoch_journal",
    "node.after_epoch_journal",
)
"""Where the node's journal cannot tell afterwards whether the motion ended: a person is asked.
(Results are published while they are journalled.)"""
SITE = Path(__file__).parents[1] / "support" / "crash_site"
PATIENCE_S = 75.0


class Lab:
    """``labos up`` as a process of its own, started again when it was killed."""

    def __init__(self, home: Path, database: str, crash: str) -> None:
        self.home, self.database = home, database
        self.mark = home / "crashed"
        self.crashes = crash.split(",")
        self.process: subprocess.Popen[bytes] | None = None
        self.kills = 0
        self.resets = 0
        self.questions: list[str] = []
        self.options = ["--speed", "1500"]
        home.mkdir(parents=True, exist_ok=True)
        self.workcell = str(rpl_with(PCR, home.parent / "rpl.yaml"))
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(SITE),
            "LABOS_CRASH_AT": crash,
            "LABOS_CRASH_MARK": str(self.mark),
        }

    def start(self) -> None:
        argv = [sys.executable, "-m", "labos", "up", self.workcell, "--simulate", "--quiet", *self.options]
        argv += ["--home", str(self.home), "--database", self.database]
        with (self.home / "up.log").open("ab") as log:
            self.process = subprocess.Popen(argv, env=self.environment, stdout=log, stderr=log)

    def marks(self) -> list[Path]:
        """The files that the crashes leave."""
        return [
            self.mark.with_name(f"crashed.{n}" if n > 1 else "crashed")
            for n in range(1, len(self.crashes) + 1)
        ]

    def keep_up(self) -> None:
        """Start the kernel again if it was killed; anything else that ends it is a fault."""
        assert self.process is not None
        code = self.process.poll()
        if code is None:
            return
        assert code == -signal.SIGKILL, (code, (self.home / "up.log").read_text()[-3000:])
        self.kills += 1
        self.start()

    def stop(self) -> int:
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)

    def ask(self, what: Any) -> Any:
        """Call ``what(client)`` until a living kernel answers."""
        give_up = time.monotonic() + PATIENCE_S
        while time.monotonic() < give_up:
            self.keep_up()
            if find_kernel(self.home) is not None:
                try:
                    with LabClient(home=self.home, patience_s=2.0) as client:
                        return what(client)
                except LabosError:
                    pass
            time.sleep(0.1)
        raise AssertionError("no kernel answered:\n" + (self.home / "up.log").read_text()[-3000:])

    def fold_log(self) -> tuple[LabState, list[Any]]:
        store = open_store(self.database, read_only=True)
        try:
            records = list(store.read())
        finally:
            store.close()
        state = LabState()
        fold(state, records)
        return state, records

    def be_a_person(self, world: World) -> None:
        """Look at the bench and answer what is asked; bring modules out of their errors."""
        state, _ = self.fold_log()
        for question in state.interventions.open.values():
            choice = look(world, state, question)
            self.questions.append(question.kind)
            self.ask(lambda client, q=question, c=choice: _answer(client, q.id, c))
        alive = {run.workflow for run in (*state.runs.active.values(), *state.runs.queued.values())}
        for name, module in state.modules.by_name.items():
            if module.status == "ERROR" and f"do {local(name)}.reset" not in alive:
                key = f"reset {self.resets}"
                self.ask(lambda client, n=name, k=key: client.do(n, "reset", user="person", request=k))
                self.resets += 1

    def see_out(self, runs: list[str]) -> tuple[LabState, list[Any]]:
        """Be the person of this lab until its runs have ended, starting it again when it was killed."""
        world = World(str(next((self.home / "world").glob("rpl.db"))))
        give_up = time.monotonic() + PATIENCE_S * len(self.crashes)
        try:
            while True:
                assert time.monotonic() < give_up, (self.home / "up.log").read_text()[-3000:]
                self.keep_up()
                state, records = self.fold_log()
                alive = state.runs.active or state.runs.queued
                if not alive and len(runs) + self.resets == state.runs.named:
                    return state, records
                self.be_a_person(world)
                time.sleep(0.3)
        finally:
            world.close()


def submit_twice(lab: Lab) -> list[str]:
    """Two PCRs of two users."""
    pcr = find_spec("workflows", "pcr")
    payload = {"seal": {"time": 3.0}}
    runs = [
        lab.ask(lambda client, k=key, u=user: client.submit(pcr, payload, user=u, request=k))
        for key, user in (("first", "ada"), ("second", "bo"))
    ]
    assert len(set(runs)) == 2
    return runs


def _answer(client: LabClient, question: str, choice: str) -> None:
    try:
        client.resolve(question, choice, by="person")
    except LabosError:
        if any(entry["id"] == question for entry in client.state()["interventions"]):
            raise


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/labos.db"
    else:
        yield request.getfixturevalue("postgres_url")


def survive(home: Path, database: str, crash: str) -> None:
    lab = Lab(home, database, crash)
    lab.start()
    try:
        state, records = lab.see_out(submit_twice(lab))
        world = World(str(home / "world" / "rpl.db"))
        try:
            missed = [what for what, mark in zip(lab.crashes, lab.marks(), strict=True) if not mark.exists()]
            assert not missed, f"{missed} was never reached"
            assert lab.kills == sum(point.startswith("kernel") for point in lab.crashes)
            if lab.questions:
                assert any(point.startswith(MAY_ASK) for point in lab.crashes), lab.questions
            assert list_differences(world, state, records) == []
            ended = [r.head.type for r in records if r.head.type in ("run.completed", "run.failed")]
            assert ended == ["run.completed"] * (2 + lab.resets)
        finally:
            world.close()
        assert lab.stop() == 0
    finally:
        if lab.process is not None and lab.process.poll() is None:
            lab.process.kill()
            lab.process.wait()


@pytest.mark.parametrize("crash", SMOKE)
def test_a_kill_costs_seconds(tmp_path: Path, crash: str) -> None:
    survive(tmp_path / "lab", f"sqlite:///{tmp_path}/labos.db", crash)


@pytest.mark.postgres
def test_a_kill_costs_seconds_on_postgres(tmp_path: Path, postgres_url: str) -> None:
    survive(tmp_path / "lab", postgres_url, "kernel.after_commit:11")


@pytest.mark.full
@pytest.mark.timeout(180)
@pytest.mark.parametrize("crash", POINTS)
def test_every_point_on_both_databases(tmp_path: Path, database: str, crash: str) -> None:
    survive(tmp_path / "lab", database, crash)


@pytest.mark.full
@pytest.mark.timeout(300)
@pytest.mark.parametrize("crashes", CHAINS)
def test_a_crash_in_a_recovery_on_both_databases(tmp_path: Path, database: str, crashes: str) -> None:
    survive(tmp_path / "lab", database, crashes)
