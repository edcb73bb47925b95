"""The adapter of any HTTP device, by a mapping; the device is a real HTTP server with its own truth."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.core.model import ActionSpec, Arg, Description
from labos.spec.rest import flaw_in
from tests.integration.adapter.bench import Bench, bench
from tests.integration.adapter.sealer import Sealer
from tests.integration.ports import free_endpoint
from tests.support.proxy import Proxy

SEAL = ActionSpec(
    name="seal",
    args=(
        Arg(name="time", type="float"),
        Arg(name="temperature", type="float", required=False, default=175.0),
    ),
)
DESCRIPTION = Description(driver="rest_node", version="", description="", actions=(SEAL,))
STATE = {"path": "/state", "status": "State", "busy": ["BUSY"], "error": ["ERROR"], "why": "why"}
PAPER = {
    "action": {"path": "/action", "json": {"action_handle": "{action}", "action_vars": "{args}"}},
    "outcome": {"status": "status", "error": "error", "result": "data"},
    "state": STATE,
    "reset": {"path": "/reset"},
    "resources": {"path": "/levels", "at": "levels"},
}
JOBS = {
    "actions": {"seal": {"path": "/jobs", "json": {"settings": {"time": "{time}"}}}},
    "outcome": {"status": "state", "running": ["running"], "error": "error", "result": "data"},
    "job": {"path": "/jobs/{id}", "id": "job.id"},
    "state": STATE,
}
OUR_JOBS = {
    **JOBS,
    "actions": {"seal": {"path": "/jobs", "json": {"id": "{id}", "settings": {"time": "{time}"}}}},
    "job": {"path": "/jobs/{id}"},
}


@pytest.fixture
def sealer() -> Iterator[Sealer]:
    device = Sealer()
    yield device
    device.close()


@pytest.fixture
def proxy(sealer: Sealer) -> Iterator[Proxy]:
    proxy = Proxy(sealer.port)
    yield proxy
    proxy.close()


def run(folder: Path, scenario: Callable[[Bench], Awaitable[None]]) -> None:
    async def main() -> None:
        async with bench(folder, free_endpoint()) as here:
            await asyncio.wait_for(scenario(here), 60)

    asyncio.run(main())


async def adapter(here: Bench, url: str, mapping: dict[str, Any]) -> None:
    await here.adapter("rest_node", DESCRIPTION, rest_node_address=url, rest=mapping)
    await here.idle()


def test_the_papers_sealer(sealer: Sealer, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        names = {"seal": {"args": {"temperature": "temp"}}}
        await here.adapter("rest_node", DESCRIPTION, rest_node_address=sealer.url, rest=PAPER, actions=names)
        await here.idle()
        await here.start("a1", "seal", time=3.0)
        done = await here.outcome("a1")
        assert (done.succeeded, done.result) == (True, {"foil": 999})
        assert sealer.seals == [{"time": 3.0, "temp": 175.0}]
        sealer.broken = "out of foil"
        await here.in_error("out of foil")
        assert (await here.kernel.recover("a2")).succeeded
        await here.idle()

    run(tmp_path, scenario)


@pytest.mark.parametrize("mapping", [JOBS, OUR_JOBS], ids=["the device's id", "our id"])
def test_jobs_are_asked_about(sealer: Sealer, tmp_path: Path, mapping: dict[str, Any]) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, mapping)
        await here.start("a1", "seal", time=3.0)
        assert (await here.outcome("a1")).result == {"foil": 999}
        assert list(sealer.jobs) == (["a1"] if mapping is OUR_JOBS else ["j1"])

    run(tmp_path, scenario)


@pytest.mark.parametrize("mapping", [PAPER, JOBS, OUR_JOBS], ids=["no job", "the device's id", "our id"])
def test_a_lost_answer(sealer: Sealer, proxy: Proxy, tmp_path: Path, mapping: dict[str, Any]) -> None:
    """Only a job that bears an id of ours can be found again."""

    async def scenario(here: Bench) -> None:
        await adapter(here, proxy.url, mapping)
        proxy.lose_next(b"POST")
        await here.start("a1", "seal", time=3.0)
        if mapping is OUR_JOBS:
            assert (await here.outcome("a1")).succeeded
        else:
            assert "lost" in (await here.status("a1", "interrupted")).why
        again = await here.start("a1", "seal", time=3.0)
        assert again.status in ("finished", "interrupted")
        assert len(sealer.seals) == 1

    run(tmp_path, scenario)


def test_what_a_mapping_lacks_is_said() -> None:
    assert flaw_in({"outcome": {}}) == "neither `action` nor `actions` says how an action is started"
    assert flaw_in({"action": {"path": "/a"}, "job": {}}) == "job.path: field required"
    assert "extra inputs" in flaw_in({"action": {"path": "/a", "body": 1}})
    assert flaw_in(PAPER) == ""
