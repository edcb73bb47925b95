"""Requests of several parts: whenever the kernel is killed, all of one or nothing of it is in the log."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client._lab import API
from labos.core.decide.nodes import JoinNode
from labos.core.ids import ModuleName, StationName
from labos.core.state import LabState
from labos.runtime.ledger import load
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.store import find_sqlite_path, open_store, parse_url

FLOW = "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"
SEALER, CAMERA = StationName("rpl/sealer.default"), StationName("rpl/camera_module.plate_station")
ARMS = ("sciclops",)
SMALL = """
labos: 1
name: corner
modules:
  - {name: oven, about: {stations: {nest: {}}, actions: {bake: {duration: 1}}}}
"""
PLACED = [
    {"station": "sealer.default", "labware": "plate96"},
    {"station": "camera_module.plate_station", "labware": "plate96"},
]
RUN = {"workflow": {"text": FLOW}, "user": "ada", "workcell": "rpl", "place": PLACED}
BATCH = {
    "workflow": {"text": FLOW},
    "user": "ada",
    "workcell": "rpl",
    "payloads": [{}] * 4,
}


def list_standing(state: LabState) -> list[bool]:
    return [holds(state, place) for place in (SEALER, CAMERA)]


def holds(state: LabState, station: str) -> bool:
    return bool(state.bench.stations[StationName(station)].labware)


def list_submitted(state: LabState) -> list[bool]:
    return [*list_standing(state), any(run.workflow == "f" for run in state.runs.queued.values())]


class Copies:
    """What would be on disk if the kernel were killed behind each of its commits."""

    def __init__(self, lab: LabThread, folder: Path) -> None:
        self.files: list[Path] = []
        store, self._folder = lab.runtime.store, folder
        append, self._log = store.append, find_sqlite_path(parse_url(lab.settings.database))

        def append_and_copy(*given: Any) -> Any:
            head = append(*given)
            self._copy()
            return head

        store.append = append_and_copy  # type: ignore[method-assign]

    def _copy(self) -> None:
        file = self._folder / f"{len(self.files)}.db"
        with closing(sqlite3.connect(self._log)) as log, closing(sqlite3.connect(file)) as copy:
            log.backup(copy)
        self.files.append(file)

    def states(self) -> Iterator[LabState]:
        for file in self.files:
            with closing(open_store(f"sqlite:///{file}", create=False, read_only=True)) as store:
                yield load(store, snapshots=False)[0]


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    with LabThread(Settings.make(tmp_path / "lab", simulate=True), [cell], nodes="none") as running:
        yield running


def join(lab: LabThread, module: str) -> None:
    name = ModuleName(f"rpl/{module}")
    command = JoinNode(name, "journal", "instance", module, "1", "about", "IDLE", True)
    assert lab._loop is not None
    asyncio.run_coroutine_threadsafe(lab.runtime.kernel.execute(command, name), lab._loop).result(10)


def test_a_kill_between_two_commits_leaves_no_half(lab: LabThread, tmp_path: Path) -> None:
    for arm in ARMS:
        join(lab, arm)
    copies = Copies(lab, tmp_path)
    parked: dict[str, Any] = {}
    with httpx.Client(base_url=lab.url + API, timeout=30) as http:

        def ask(path: str, body: dict[str, Any], key: str) -> Any:
            answer = http.post(path, json=body, headers={"idempotency-key": key})
            position = http.get("/health").json()["position"]
            again = http.post(path, json=body, headers={"idempotency-key": key})
            assert answer.status_code in (200, 201), answer.text
            assert (again.status_code, again.content) == (answer.status_code, answer.content)
            assert http.get("/health").json()["position"] == position, "twice is once"
            return answer.json()

        http.post("/control/pause", json={"target": "lab", "by": "ada"})  # nothing starts meanwhile
        ask("/runs", RUN, "run")
        ask("/runs/batch", BATCH, "batch")
        parked.update(ask("/workcells/rpl/access", {"by": "ada", "park": True}, "access"))
        ask("/workcells", {"text": SMALL, "name": "corner.yaml", "by": "ada"}, "workcell")
        both = {"hidex.default": ["plate96"], "peeler.default": ["plate96"]}
        ask("/stations/declare", {"stations": both, "by": "ada"}, "declare")
        full = {"ot2_cp_gamma.deck1": ["plate96"], "hidex.default": ["plate96"]}
        refused = http.post("/stations/declare", json={"stations": full, "by": "ada"})
        assert refused.status_code == 409, refused.text
    wholes: list[Callable[[LabState], list[bool]]] = [
        list_submitted,
        lambda state: [f"batch-{number}" in state.runs.requests for number in range(4)],
        lambda state: ["rpl" in state.lab.access, state.runs.named == 5 + len(ARMS)],
        lambda state: ["corner" in state.lab.workcells, is_known(state, "corner/oven.nest")],
        lambda state: [holds(state, f"rpl/{name}.default") for name in ("hidex", "peeler")],
    ]
    assert len(parked["parking"]) == len(ARMS)
    states = list(copies.states())
    assert not any(holds(state, "rpl/ot2_cp_gamma.deck1") for state in states)
    for whole in wholes:
        assert all(whole(states[-1])), "in the end it has happened"
        assert not any(whole(states[0]))
        for state in states:
            assert len(set(whole(state))) == 1, "a half"


def is_known(state: LabState, station: str) -> bool:
    found = state.bench.stations.get(StationName(station))
    return found is not None and found.known


def test_a_refused_run_leaves_nothing_of_its_labware(lab: LabThread) -> None:
    with httpx.Client(base_url=lab.url + API, timeout=30) as http:
        before = http.get("/health").json()["position"]
        asked = [
            RUN | {"experiment": "E9"},
            RUN | {"place": [*PLACED, {"station": "sealer.default", "labware": "plate96"}]},
            RUN | {"payload": {"text": "x" * 70_000}},
        ]
        for body in asked:
            assert http.post("/runs", json=body, headers={"idempotency-key": "k"}).status_code in (400, 409)
        assert http.get("/health").json()["position"] == before
        state = lab.runtime.kernel.state
        assert list_standing(state) == [False, False]
        world = lab.runtime.world("rpl")
        assert world.at("sealer.default") == world.at("camera_module.plate_station") == []
        assert http.post("/runs", json=RUN, headers={"idempotency-key": "k"}).status_code == 201
    with LabClient(lab.url) as client:
        assert [run["id"] for run in client.runs()["runs"]] == ["R1"]
