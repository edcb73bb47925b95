"""The adapter of any HTTP device, by a mapping; the device is a real HTTP server with its own truth."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.core.model import ActionSpec, Arg, Description
from labos.settings import free_port
from labos.spec.rest import find_flaw
from tests.integration.adapter.bench import ROOT, Bench, bench
from tests.integration.adapter.sealer import Sealer
from tests.integration.bus.contract import until
from tests.integration.ports import free_endpoint
from tests.support.foreign import ForeignProcess
from tests.support.proxy import Proxy

SEAL = ActionSpec(
    name="seal",
    args=(
        Arg(name="time", type="float"),
        Arg(name="temperature", type="float", required=False, default=175.0),
    ),
    duration_s=0.2,
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
STATELESS = {key: told for key, told in PAPER.items() if key != "state"}
"""Of a device that cannot say whether it works."""
OUTCOME: dict[str, Any] = {"status": "status", "error": "error", "result": "data"}
LONG = 3600.0


class SealerProcess(ForeignProcess):
    """A sealer that can be killed; it ``remembers`` its jobs or does not."""

    says_up = "the server is up"
    remembers = True

    def command(self) -> list[Path | str]:
        return [self.python, "-m", "tests.integration.adapter.sealer", str(self.port)]

    def environment(self) -> dict[str, str]:
        memory = {"MEMORY": str(self.folder / "jobs.json")} if self.remembers else {}
        return {"PYTHONPATH": str(ROOT), **memory}


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


async def adapter(here: Bench, url: str, mapping: dict[str, Any], **more: Any) -> None:
    await here.adapter("rest_node", DESCRIPTION, rest_node_address=url, rest=mapping, **more)
    await here.idle()


async def process(here: Bench, sealer: Sealer, mapping: dict[str, Any]) -> Any:
    """An adapter that can be killed, and is never out of patience."""
    config = {"rest_node_address": sealer.url, "rest": mapping, "patience_s": LONG}
    return await here.process("rest_node", DESCRIPTION, **config)


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


def test_a_device_that_stays_mute_is_not_waited_for_for_ever(sealer: Sealer, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, STATELESS, patience_s=0.2)
        sealer.go.clear()
        await here.start("a1", "seal", time=3.0)
        assert "has not answered" in (await here.status("a1", "interrupted")).why
        await here.idle()
        sealer.go.set()
        assert (await here.start("a1", "seal", time=3.0)).status == "interrupted"
        assert len(sealer.seals) == 1

    run(tmp_path, scenario)


@pytest.mark.slow
def test_a_device_that_says_that_it_works_is_waited_for(sealer: Sealer, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, PAPER, patience_s=0.2)
        sealer.go.clear()
        await here.start("a1", "seal", time=3.0)
        # At ten times a second it has long been asked more often than a mute one would be.
        await until(lambda: sealer.asked.count("GET /state") > 40, 30)
        await here.status("a1", "running")
        sealer.go.set()
        assert (await here.outcome("a1")).succeeded

    run(tmp_path, scenario)


def test_a_status_that_the_mapping_does_not_name_is_no_end(sealer: Sealer, tmp_path: Path) -> None:
    """The device goes on: a step that failed here would be followed by a motion into it."""

    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, JOBS, patience_s=5.0)
        sealer.jobs_say = {"running": "heating up"}
        sealer.go.clear()
        await here.start("a1", "seal", time=3.0)
        await until(lambda: sealer.asked.count("GET /jobs/j1") > 10, 30)
        await here.status("a1", "running")
        sealer.go.set()
        assert (await here.outcome("a1")).succeeded

    run(tmp_path, scenario)


@pytest.mark.slow
def test_a_status_that_stays_unknown_leaves_the_outcome_unknown(sealer: Sealer, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, JOBS, patience_s=0.2)
        sealer.jobs_say = {"running": "heating up", "succeeded": "finis"}
        await here.start("a1", "seal", time=3.0)
        assert "'finis'" in (await here.status("a1", "interrupted")).why
        assert len(sealer.seals) == 1

    run(tmp_path, scenario)


@pytest.mark.parametrize(
    ("status", "refused", "effects"),
    [
        (400, [], "unknown"),
        (409, [], "unknown"),
        (422, [422], "none"),
        (403, [], "none"),
        (500, [], "unknown"),
    ],
)
def test_a_4xx_at_the_end_of_a_motion_says_nothing_of_its_effects(
    sealer: Sealer, tmp_path: Path, status: int, refused: list[int], effects: str
) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, {**PAPER, "outcome": {**OUTCOME, "refused": refused}})
        sealer.ends_with = status
        await here.start("a1", "seal", time=3.0)
        failed = await here.outcome("a1")
        assert (failed.succeeded, failed.effects) == (False, effects)
        assert "the foil is torn" in failed.error

    run(tmp_path, scenario)


def test_a_job_without_an_id_is_asked_for_by_nobody(sealer: Sealer, tmp_path: Path) -> None:
    outcome = {**JOBS["outcome"], "not_started": ["closed"]}

    async def scenario(here: Bench) -> None:
        await adapter(here, sealer.url, {**JOBS, "outcome": outcome})
        sealer.nameless = True
        await here.start("a1", "seal", time=3.0)
        assert "'job.id'" in (await here.status("a1", "interrupted")).why
        assert not [asked for asked in sealer.asked if asked.startswith("GET /jobs")]
        await here.idle()
        # What says that it was not started has failed.
        sealer.closed = True
        await here.start("a2", "seal", time=3.0)
        failed = await here.outcome("a2")
        assert (failed.succeeded, failed.effects) == (False, "none")
        assert "out of service" in failed.error
        assert len(sealer.seals) == 1

    run(tmp_path, scenario)


@pytest.mark.parametrize(
    "mapping",
    [
        pytest.param(STATELESS, id="no job, no state"),
        pytest.param(PAPER, id="no job", marks=pytest.mark.full),
        pytest.param(JOBS, id="the device's id"),
        pytest.param(OUR_JOBS, id="our id", marks=pytest.mark.full),
    ],
)
@pytest.mark.slow
def test_the_adapter_is_killed_in_mid_action(sealer: Sealer, tmp_path: Path, mapping: dict[str, Any]) -> None:
    """Of a job the true result is learned; else nobody knows, and what may still work is busy."""
    sealer.go.clear()

    async def scenario(here: Bench) -> None:
        first = await process(here, sealer, mapping)
        await here.idle()
        await here.start("a1", "seal", time=3.0)
        await until(lambda: len(sealer.seals) == 1, 20)
        if mapping is JOBS:  # its id has come
            await until(lambda: b'"j1"' in (tmp_path / "arm.journal").read_bytes(), 20)
        first.kill()
        await here.await_node_gone()
        await process(here, sealer, mapping)
        if "job" not in mapping:
            assert "restarted" in (await here.status("a1", "interrupted", 40)).why
        else:
            await here.status("a1", "running", 40)
        assert (await here.start("a2", "seal", time=1.0)).status == "refused"
        sealer.go.set()
        if mapping is STATELESS:  # somebody has seen that it stands still
            assert (await here.kernel.recover("a3")).succeeded
        if "job" in mapping:
            assert (await here.outcome("a1")).result == {"foil": 999}
        await here.idle()
        again = await here.start("a1", "seal", time=3.0)
        assert again.status == ("finished" if "job" in mapping else "interrupted")
        assert len(sealer.seals) == 1

    run(tmp_path, scenario)


@pytest.mark.full
def test_the_adapter_is_killed_before_the_device_gave_an_id(sealer: Sealer, tmp_path: Path) -> None:
    sealer.name.clear()

    async def scenario(here: Bench) -> None:
        first = await process(here, sealer, JOBS)
        await here.idle()
        await here.start("a1", "seal", time=3.0)
        await until(lambda: len(sealer.seals) == 1, 20)
        first.kill()
        await here.await_node_gone()
        await process(here, sealer, JOBS)
        assert "before it received an id from the device" in (await here.status("a1", "interrupted", 40)).why
        assert (await here.start("a1", "seal", time=3.0)).status == "interrupted"
        assert len(sealer.seals) == 1

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("remembers", [True, False], ids=["it remembers", "it forgets"])
@pytest.mark.parametrize("mapping", [PAPER, JOBS, OUR_JOBS], ids=["no job", "the device's id", "our id"])
def test_the_device_is_killed_in_mid_action(tmp_path: Path, mapping: dict[str, Any], remembers: bool) -> None:
    """A job ends as the device remembers it."""
    device = SealerProcess("sealer", tmp_path / "device", free_port())
    device.remembers = remembers
    device.start()

    async def scenario(here: Bench) -> None:
        await adapter(here, device.url, mapping, patience_s=LONG)
        await here.start("a1", "seal", time=600.0)
        await until(lambda: len(device.truth("seal")) == 1, 20)
        if mapping is JOBS:
            await until(lambda: b'"j1"' in (tmp_path / "arm.journal").read_bytes(), 20)
        device.kill()
        device.start()
        if mapping is not PAPER and remembers:
            failed = await here.outcome("a1")
            assert (failed.succeeded, failed.effects) == (False, "unknown")
            assert "The power was lost." in failed.error
            assert (await here.kernel.recover("a2")).succeeded
        else:
            why = (await here.status("a1", "interrupted")).why
            assert ("lost" if mapping is PAPER else "does not know the job") in why
        await here.idle()
        again = await here.start("a1", "seal", time=600.0)
        assert again.status in ("finished", "interrupted")
        await here.start("a3", "seal", time=0.0)
        assert (await here.outcome("a3")).succeeded
        assert [told["time"] for told in device.truth("seal")] == [600.0, 0.0]

    try:
        run(tmp_path, scenario)
    finally:
        device.kill()


def test_what_a_mapping_lacks_is_said() -> None:
    assert find_flaw({"outcome": {}}) == "`action` or `actions` is needed, to define how an action is started"
    assert find_flaw({"action": {"path": "/a"}, "job": {}}) == "job.path: is missing"
    assert "is not known here" in find_flaw({"action": {"path": "/a", "body": 1}})
    assert find_flaw(PAPER) == ""
