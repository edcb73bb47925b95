"""What HTTP asks of the lab for somebody who may not: it is refused before anything is touched."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from labos.bootstrap import descriptions
from labos.bootstrap._lab import open_lab
from labos.bootstrap._runtime import LabRuntime
from labos.core.decide.users import AddUser, GrantRole
from labos.core.users import Role, on_behalf
from labos.errors import Forbidden, Refused
from labos.http.access import end_access, request_access
from labos.http.bodies import NewCampaign, NewExperiment, NewRun, SampleSheet, WorkcellFile
from labos.http.campaigns import submit_campaign
from labos.http.placing import Placing
from labos.http.samples import register_samples
from labos.http.service import WorkflowText
from labos.http.stock import Load, Unload, declare_bench, load, unload
from labos.http.workcells import apply_workcell
from labos.services.truth import bench_name
from labos.settings import Settings
from labos.spec import parse_workcell

CELL = """
labos: 1
name: corner
modules:
  - name: press
    second_person: true
    about:
      stations: {nest: {}}
      actions:
        squeeze: {effects: [{needs: {}}], duration: 2}
        home: {duration: 1}
        burn: {duration: 1, dangerous: hot}
"""
FLOW = WorkflowText(
    "labos: 1\nname: Squeeze\nsteps:\n  - {name: once, module: press, action: squeeze}\n", "flow.yaml"
)
BURN = WorkflowText(
    "labos: 1\nname: Burn\nsteps:\n  - {name: once, module: press, action: burn}\n", "burn.yaml"
)
CAMPAIGN = "labos: 1\ncampaign: twice\nworkflow: flow.yaml\nrows: {list: [{}, {}]}\n"
NEST = Placing("press.nest", "plate96")


def lab_with_people(tmp_path: Path, scene: Callable[[LabRuntime], Awaitable[None]]) -> None:
    """A simulated lab whose admin is ``root-1``; ada and bo submit, olga operates, vic looks on; robot is a
    service account that submits."""

    async def play() -> None:
        settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
        cell = parse_workcell(CELL, descriptions())
        async with open_lab(settings, workcells=[cell]) as lab:
            people: dict[str, Role] = {"ada": "submitter", "bo": "submitter", "olga": "operator"}
            await lab.kernel.execute(AddUser("root-1"), "somebody")
            for name in ("ada", "bo", "olga", "vic"):
                await lab.kernel.execute(AddUser(name), "root-1")
            await lab.kernel.execute(AddUser("robot", "service"), "root-1")
            for name, role in (people | {"robot": "submitter"}).items():
                await lab.kernel.execute(GrantRole(f"user:{name}", role), "root-1")
            await scene(lab)
            assert not lab.kernel.faults

    asyncio.run(play())


async def plates(lab: LabRuntime) -> int:
    """How many plates stand on the simulated bench."""
    nest = lab.kernel.state.bench.stations[lab.service.station("press.nest")]
    return len(await asyncio.to_thread(lab.world("corner").at, bench_name(nest.spec)))


def test_a_refusal_leaves_the_simulated_bench_as_it_is(tmp_path: Path) -> None:
    async def scene(lab: LabRuntime) -> None:
        service = lab.service
        tries: list[Callable[[], Awaitable[object]]] = [
            lambda: load(service, Load(station="press.nest", labware="plate96", by="ada"), "ada"),
            lambda: declare_bench(service, {"press.nest": ["plate96"]}, "", "ada", empty=False),
            lambda: service.submit(NewRun(workflow=FLOW, user="ada", place=[NEST])),
            lambda: service.submit(NewRun(workflow=FLOW, user=on_behalf("robot", "olga"), place=[NEST])),
            lambda: end_access(service, "corner", "ada", "", []),
        ]
        for attempt in tries:
            with pytest.raises(Forbidden):
                await attempt()
        assert (await plates(lab), lab.kernel.state.runs.named) == (0, 0)
        await service.submit(NewRun(workflow=FLOW, user="olga", place=[NEST]))
        assert await plates(lab) == 1
        with pytest.raises(Forbidden):
            await unload(service, Unload(station="press.nest", by="ada"), "ada")
        assert await plates(lab) == 1

    lab_with_people(tmp_path, scene)


def test_nothing_is_kept_or_started_for_somebody_who_may_not(tmp_path: Path) -> None:
    async def scene(lab: LabRuntime) -> None:
        service, begun = lab.service, lab.kernel.state.position
        files = sorted((tmp_path / "lab").rglob("blobs/**/*"))
        campaign = NewCampaign(text=CAMPAIGN, workflow=FLOW, user="vic", dry_run=True)
        sheet = SampleSheet(text="well,sample\nA1,x\n", name="s.csv", station="press.nest")
        tries: list[Callable[[], Awaitable[object]]] = [
            lambda: service.submit(NewRun(workflow=FLOW, user="vic")),
            lambda: service.submit(NewRun(workflow=FLOW, user="eve")),
            lambda: service.start_experiment(NewExperiment(name="app", user="vic", closing=FLOW)),
            lambda: submit_campaign(service, campaign, ""),
            lambda: register_samples(service, sheet, "vic"),
            lambda: apply_workcell(service, WorkcellFile(text=CELL, by="olga", dry_run=True), "olga"),
            # Its arms would be parked, at the highest priority, before it is refused.
            lambda: request_access(service, "corner", "ada", "", park=True),
        ]
        for attempt in tries:
            with pytest.raises(Forbidden):
                await attempt()
        assert lab.kernel.state.position == begun
        assert sorted((tmp_path / "lab").rglob("blobs/**/*")) == files

    lab_with_people(tmp_path, scene)


def test_runs_experiments_and_campaigns_are_the_askers_own(tmp_path: Path) -> None:
    async def scene(lab: LabRuntime) -> None:
        service, state = lab.service, lab.kernel.state
        run, _ = await service.submit(NewRun(workflow=FLOW, user="ada"))
        mine = await service.start_experiment(NewExperiment(name="app", user="ada"))
        with pytest.raises(Forbidden):
            await service.change(run, "cancel", "bo")
        with pytest.raises(Refused):
            await service.submit(NewRun(workflow=FLOW, user="bo", experiment=mine))
        # Whoever keeps it alive, or lets it note something, goes on with it.
        for attempt in (
            lambda: service.note(mine, "decision", "x", {}, "bo"),
            lambda: service.end_experiment(mine, "ended", "bo"),
        ):
            with pytest.raises(Forbidden):
                await attempt()
        with pytest.raises(Forbidden):
            service.note_heartbeat(mine, "bo")
        with pytest.raises(Forbidden):
            service.check_noting(mine, "bo")
        service.note_heartbeat(mine, "ada")
        campaign, _ = await submit_campaign(
            service, NewCampaign(text=CAMPAIGN, workflow=FLOW, user=on_behalf("robot", "ada")), "key"
        )
        assert state.campaigns.open[campaign].user == "ada"  # type: ignore[index]
        # The same key of another is another's.
        with pytest.raises(Refused):
            await submit_campaign(service, NewCampaign(text=CAMPAIGN, workflow=FLOW, user="bo"), "key")
        await service.change(run, "cancel", "olga")

    lab_with_people(tmp_path, scene)


def test_a_second_person_approves_what_is_dangerous(tmp_path: Path) -> None:
    async def scene(lab: LabRuntime) -> None:
        service, asked = lab.service, lab.kernel.state.interventions
        run, _ = await service.submit(NewRun(workflow=BURN, user="olga"))
        (question,) = asked.find_by_run(run)
        with pytest.raises(Refused, match="second person"):
            await service.resolve(question.id, "approve", "olga", "", None)
        with pytest.raises(Forbidden):
            await service.resolve(question.id, "approve", "ada", "", None)
        await service.resolve(question.id, "approve", "root-1", "", None)
        assert not asked.find_by_run(run)
        assert [r.head.actor for r in lab.store.read() if r.head.type == "run.approved"] == ["root-1"]

    lab_with_people(tmp_path, scene)


def test_the_log_names_a_service_account_and_the_person_it_acts_for(tmp_path: Path) -> None:
    async def scene(lab: LabRuntime) -> None:
        run, _ = await lab.service.submit(NewRun(workflow=FLOW, user=on_behalf("robot", "ada")))
        (record,) = [r for r in lab.store.read() if r.head.type == "run.submitted"]
        assert (record.head.actor, run) == ("robot for ada", record.head.stream)
        assert b'"user":"ada"' in record.payload

    lab_with_people(tmp_path, scene)


def test_a_lab_with_users_starts_again(tmp_path: Path) -> None:
    async def scene(lab: LabRuntime) -> None:
        await lab.service.start_experiment(NewExperiment(name="app", user="ada"))

    lab_with_people(tmp_path, scene)

    async def again() -> None:
        settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
        changed = parse_workcell(CELL.replace("duration: 2", "duration: 3"), descriptions())
        async with open_lab(settings, workcells=[changed]) as lab:
            assert list(lab.kernel.state.users.known) == ["root-1", "ada", "bo", "olga", "vic", "robot"]
            assert lab.kernel.state.users.list_admins() == ["root-1"]

    asyncio.run(again())
