"""Access of a person to a workcell: first, runs park the arms."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from labos.core.decide.access import EndAccess, ReportedChange, RequestAccess
from labos.core.decide.runs import SubmitRun
from labos.core.ids import local, workcell_of
from labos.core.modules import ModuleStatus
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.core.users import find_person
from labos.errors import LabosError
from labos.http.limits import Name
from labos.http.service import LabService, WorkflowText
from labos.http.stock import check
from labos.spec.about import find_description

PARKED_FIRST = 1_000_000
"""The priority of parking runs: a person is waiting at the workcell."""


class StationChange(msgspec.Struct, forbid_unknown_fields=True):
    """``what``: ``empty``, labware that the log knows, or a labware type."""

    station: Name
    what: Name


async def request_access(service: LabService, workcell: str, by: str, why: str, *, park: bool) -> list[str]:
    """Hold a workcell for a person; returns the runs that park its arms."""
    cell = service.workcell(workcell).name
    state = service.kernel.state
    inside = state.lab.access.get(cell)
    check(service, RequestAccess(cell, by, why), by)
    parking: list[SubmitRun] = []
    for module in _list_parkable(service, state, cell) if park and inside is None else ():
        workflow = WorkflowText(_HOME.format(module=module), f"do {module}.home")
        try:
            plan = (await service.compile(workflow, {}, cell)).plan
            pins = service.list_pins(workflow, plan)
            run = SubmitRun(plan, find_person(by), priority=PARKED_FIRST, pins=pins)
            check(service, run, by)
        except LabosError:
            continue  # an arm that cannot be parked must not keep a person out
        parking.append(run)
    events = await service.kernel.execute(RequestAccess(cell, by, why, tuple(parking)), by)
    return [event.run for event in events if isinstance(event, RunSubmitted)]


async def end_access(
    service: LabService, workcell: str, by: str, note: str, changes: Sequence[StationChange]
) -> None:
    """The access has ended; the changes are recorded with its end. Raises Refused, NotFound."""
    cell = service.workcell(workcell).name
    reported = [ReportedChange(service.station(change.station), change.what) for change in changes]
    for change in reported:
        known = change.what == "empty" or change.what in service.kernel.state.bench.labware
        if not known:
            service.expect_labware(change.what)
    command = EndAccess(cell, by, note, tuple(reported))
    await service.kernel.execute(command, by)


def _list_parkable(service: LabService, state: LabState, cell: str) -> list[str]:
    """The manipulators of a workcell that can go to their home position now, by their local names."""
    found = []
    for name, module in state.modules.by_name.items():
        about = find_description(module.spec, service.parts.descriptions)
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
