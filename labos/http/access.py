"""A person reaches into a workcell: arms are parked by runs of their own first."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import msgspec

from labos.core.decide.access import Change, EndAccess, RequestAccess
from labos.core.decide.runs import SubmitRun
from labos.core.ids import LabwareId, local, workcell_of
from labos.core.modules import ModuleStatus
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.core.users import person_of
from labos.errors import LabosError
from labos.http.hands import plate_of
from labos.http.limits import Name
from labos.http.service import LabService, WorkflowText
from labos.http.stock import check, expect
from labos.node.world import World
from labos.services.truth import bench_name
from labos.spec.about import described

PARKED_FIRST = 1_000_000
"""The priority of parking: somebody stands there and waits."""


class StationChange(msgspec.Struct, forbid_unknown_fields=True):
    """``what``: ``empty``, labware that is known, or a type of labware."""

    station: Name
    what: Name


async def request_access(service: LabService, workcell: str, by: str, why: str, *, park: bool) -> list[str]:
    """Hold a workcell for a person; returns the runs that park its arms."""
    cell = service.workcell(workcell).name
    state = service.kernel.state
    inside = state.lab.access.get(cell)
    check(service, RequestAccess(cell, by, why), by)
    parking: list[SubmitRun] = []
    for module in _parkable(service, state, cell) if park and inside is None else ():
        workflow = WorkflowText(_HOME.format(module=module), f"do {module}.home")
        try:
            plan = (await service.compile(workflow, {}, cell)).plan
            pins = service.pins_of(workflow, plan)
            run = SubmitRun(plan, person_of(by), priority=PARKED_FIRST, pins=pins)
            check(service, run, by)
        except LabosError:
            continue  # an arm that cannot be parked must not keep a person out
        parking.append(run)
    events = await service.kernel.execute(RequestAccess(cell, by, why, tuple(parking)), by)
    return [event.run for event in events if isinstance(event, RunSubmitted)]


async def end_access(
    service: LabService, workcell: str, by: str, note: str, told: Sequence[StationChange]
) -> None:
    """The person is out; what was changed is written down with it. Raises Refused, NotFound."""
    cell = service.workcell(workcell).name
    changes = [Change(service.station(change.station), change.what) for change in told]
    for change in changes:
        known = change.what == "empty" or change.what in service.kernel.state.bench.labware
        if not known:
            service.expect_labware(change.what)
    command = EndAccess(cell, by, note, tuple(changes))
    if service.parts.simulated:
        expect(service, command, by)
        await asyncio.to_thread(_on_the_bench, service.parts.world(cell), service.kernel.state, changes)
    await service.kernel.execute(command, by)


def _on_the_bench(world: World, state: LabState, changes: Sequence[Change]) -> None:
    """On a simulated bench nobody has reached in: what was told is done to it, unless it is so."""
    where = {
        labware: plate_of(world, state, labware)
        for labware in [LabwareId(change.what) for change in changes]
        if labware in state.bench.labware
    }
    for change in sorted(changes, key=lambda change: change.what != "empty"):
        place = bench_name(state.bench.stations[change.station].spec)
        if change.what == "empty":
            for plate in world.at(place):
                if plate not in where.values():
                    world.carry(plate, "")
        elif LabwareId(change.what) in where:
            plate = where[LabwareId(change.what)]
            if plate and plate not in world.at(place):
                world.carry(plate, place)
        elif len(world.at(place)) <= len(state.bench.stations[change.station].labware):
            world.stock(place, change.what)


def _parkable(service: LabService, state: LabState, cell: str) -> list[str]:
    """The manipulators of a workcell that can go home now, by their local names."""
    found = []
    for name, module in state.modules.by_name.items():
        about = described(module.spec, service.parts.descriptions)
        if workcell_of(name) != cell or about is None or not about.manipulator:
            continue
        if (
            about.action("home")
            and module.status in (ModuleStatus.IDLE, ModuleStatus.BUSY)
            and not module.out_of_service
        ):
            found.append(local(name))
    return found


_HOME = """\
labos: 1
name: do {module}.home
steps:
  - {{name: home, module: {module}, action: home}}
"""
