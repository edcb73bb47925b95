"""The asynchronous client against a lab: many wait at once, and whoever is cancelled is given up."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import pytest

from labos.client import AsyncExperiment, AsyncLabClient, LabClient, LabUnreachable, RunFailed
from labos.errors import BadInput, NotFound
from tests.support.reading import WORKFLOW, open_reading_lab

READ = {"text": WORKFLOW, "name": "read.yaml"}
AT_ONCE = 64


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with open_reading_lab(tmp_path_factory.mktemp("reading")) as running:
        with LabClient(running.url) as client:
            client.place("hidex.default", "plate96", "ada")
            client.give("P1", "shared", "ada")
        yield running.url


def test_an_experiment_in_a_block(url: str) -> None:
    async def work() -> None:
        async with AsyncLabClient(url) as lab, AsyncExperiment(lab, "plates", "ada") as experiment:
            await experiment.note("decision", "which assay", function="OD590")
            result = await experiment.run(READ)  # type: ignore[arg-type]
            assert result.experiment == experiment.id
            assert len((await lab.readings(result.id)).to_frame()) == 96
            runs = await experiment.submit_all(READ, [{}, {}, {}])  # type: ignore[arg-type]
            ended = [result.id async for result in experiment.as_completed(runs)]
            assert sorted(ended) == sorted(runs)
        async with AsyncLabClient(url) as lab:
            state = await lab.state(waits=False)
            assert experiment.id not in str(state["experiments"])
            with pytest.raises(NotFound):
                await lab.status("R999")

    asyncio.run(work())


def test_those_who_wait_keep_nobody_from_asking(url: str) -> None:
    async def work() -> None:
        async with AsyncLabClient(url) as lab:
            await lab.control("pause", "lab", "ada")
            runs = await lab.submit_all(READ, [{}] * AT_ONCE, user="ada")
            waiting = {run: asyncio.create_task(lab.wait(run)) for run in runs}
            await lab.health()
            for run in (runs[-1], runs[0]):
                await lab.cancel(run, "ada")
                assert (await waiting.pop(run)).status == "cancelled"
            assert not any(task.done() for task in waiting.values())
            await asyncio.gather(*(lab.cancel(run, "ada") for run in waiting))
            assert {result.status for result in await asyncio.gather(*waiting.values())} == {"cancelled"}
            await lab.control("resume", "lab", "ada")

    asyncio.run(work())


def test_whoever_is_cancelled_asks_no_more(url: str) -> None:
    before = set(threading.enumerate())

    async def work() -> None:
        async with AsyncLabClient(url) as lab:
            await lab.control("pause", "lab", "ada")
            run = await lab.submit(READ, user="ada")
            task = asyncio.create_task(lab.wait(run))
            await lab.health()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(anext(aiter(lab.as_completed([run]))), 0.05)
            await lab.cancel(run, "ada")
            await lab.control("resume", "lab", "ada")
            for thread in set(threading.enumerate()) - before:
                if thread.name == "lab-call":
                    await asyncio.to_thread(thread.join)

    asyncio.run(work())


def test_events_are_followed(url: str) -> None:
    async def work() -> None:
        async with AsyncLabClient(url) as lab:
            after = (await lab.health())["position"]
            run = await lab.submit(READ, user="ada")
            seen = []
            async for event in lab.events(after, follow=True, stream=run):
                seen.append(event["type"])
                if event["type"] == "run.completed":
                    break
            assert "run.submitted" in seen
            listed = [event["type"] async for event in lab.events(after, stream=run)]
            assert listed == seen

    asyncio.run(work())


def test_an_error_in_the_block_ends_the_experiment_with_it(url: str) -> None:
    async def fail(lab: AsyncLabClient, experiment: AsyncExperiment) -> None:
        async with experiment:
            run = await lab.submit(READ, user="ada", experiment=experiment.id)
            await lab.cancel(run, "ada")
            async for _ in experiment.as_completed([run]):
                pytest.fail("it did not complete")

    async def work() -> None:
        async with AsyncLabClient(url) as lab:
            experiment = AsyncExperiment(lab, "plates", "ada")
            with pytest.raises(RunFailed):
                await fail(lab, experiment)
            events = [event async for event in lab.events(stream=experiment.id)]
            assert events[-1]["type"] == "experiment.ended"

    asyncio.run(work())


def test_whoever_waits_when_the_client_is_closed_is_told(url: str) -> None:
    async def work() -> None:
        async with AsyncLabClient(url) as lab, AsyncLabClient(url) as other:
            await other.control("pause", "lab", "ada")
            run = await other.submit(READ, user="ada")
            task = asyncio.create_task(lab.wait(run))
            await lab.health()
            await lab.close()
            with pytest.raises(LabUnreachable, match="closed"):
                await task
            await other.cancel(run, "ada")
            await other.control("resume", "lab", "ada")

    asyncio.run(work())


@pytest.mark.parametrize("name", ["", ".", ".."])
def test_a_name_that_names_nothing_is_refused(url: str, name: str) -> None:
    with LabClient(url) as lab, pytest.raises(BadInput, match="is not a name"):
        lab.status(name)
