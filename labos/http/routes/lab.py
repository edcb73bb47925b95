"""The lab as a whole: its health, its state, and its nodes."""

from __future__ import annotations

from functools import partial

import msgspec
from starlette.responses import Response

from labos.core.modules import StopReported
from labos.core.registry import Event
from labos.core.structs import make_from
from labos.http import wire
from labos.http.asking import NodeAnswer, ask_nodes
from labos.http.bodies import EmergencyStop
from labos.http.control import ControlRequest, ControlResult, control
from labos.http.limits import name_in_emergency
from labos.http.operation import Call, Method, Operation, change, read
from labos.http.queries import NodesQuery, StateQuery
from labos.http.views import LabView
from labos.runtime.stop import StopReport
from labos.services.inventory import Inventory, count_inventory
from labos.services.times import iso_time


class LogCheckView(msgspec.Struct, frozen=True):
    """The check of the whole log in the background: how many records are ``checked`` of how many, whether it
    is ``done``, and the ``damage`` that it found."""

    checked: int
    of: int
    done: bool
    damage: str


class Health(msgspec.Struct, frozen=True):
    """``status`` is ``ok`` or ``failed``. ``position`` is the position of the last event on disk.
    ``suspended`` is the reason why nothing starts (a fault in planning; empty: planning works).
    ``broken_drivers`` lists drivers that cannot be used, each with the reason."""

    status: str
    lab: str
    name: str
    epoch: int
    position: int
    suspended: str
    simulated: bool
    pace: float
    broken_drivers: dict[str, str]
    log_check: LogCheckView | None


class NodeAnswers(msgspec.Struct, frozen=True):
    modules: list[NodeAnswer]


_NODE = {"module": "rpl/sealer", "name": "rpl/sealer", "answer": "IDLE", "why": "", "checked": None}
_CONTROL = {"target": "rpl/ot2_pcr_alpha", "by": "ada", "why": "new tips"}
_CONTROLLED = {"kind": "module", "target": "rpl/ot2_pcr_alpha", "runs": []}

_control = partial(
    change,
    client=Method("control", by_hand=True),
    problems=("not_found", "refused"),
    example=_CONTROL,
    example_answer=_CONTROLLED,
)
"""A pause, a resumption or a cancellation of whatever a name stands for."""


@read(
    route="GET /health",
    client=Method("health"),
    at_kernel=True,
    summary="Show whether the kernel works",
)
async def get_health(call: Call) -> Health:
    """Probes can use `/health`, which answers `{"status": …}` and needs no user."""
    kernel, parts = call.kernel, call.service.parts
    lab, check = kernel.state.lab, parts.log_check
    return make_from(
        Health,
        lab,
        status="failed" if kernel.failed.done() else "ok",
        lab=lab.id,
        position=kernel.durable,
        suspended=kernel.suspended,
        simulated=parts.simulated,
        broken_drivers=dict(parts.broken_drivers),
        log_check=LogCheckView(**check.make_view()) if check is not None else None,
    )


@read(
    route="GET /state",
    client=Method("state"),
    answer=LabView,
    summary="Show the present state of the lab",
)
async def get_state(call: Call, query: StateQuery) -> Response:
    """Requests at the same time share one answer, which is newer than each of them."""
    return wire.answer_encoded(await call.api.state_for(call.viewer, waits=query.waits).get())


@read(
    route="GET /inventory",
    client=Method("inventory"),
    summary="Show the resources that are left, and when they run out",
)
def get_inventory(call: Call) -> Inventory:
    """Levels and lots of all resources, the content of stacks, the room in waste stations, and in `runs_out`
    the first run that would have too little. Times are in UTC nanoseconds."""
    now = call.kernel.clock.now_ns()
    return count_inventory(call.kernel.state, now, iso_time(now)[:10])


@read(
    route="GET /nodes",
    client=Method("ask_nodes", by_hand=True),
    summary="Ask the nodes of modules for their present state",
    example_answer={"modules": [_NODE]},
)
async def list_nodes(call: Call, query: NodesQuery) -> NodeAnswers:
    """The lab asks the modules' nodes over the bus and waits at most two seconds. Nothing moves."""
    found = await ask_nodes(call.service, query.module, check=query.check)
    await call.kernel.flush()
    return NodeAnswers(found)


@_control(
    route="POST /control/pause",
    summary="Pause a run, an experiment, a module, a workcell or the lab",
)
async def pause(call: Call, body: ControlRequest) -> ControlResult:
    """Nothing more starts there except resets; actions under way continue to their end."""
    return await control(call.kernel, "pause", body)


@_control(
    route="POST /control/resume",
    summary="Resume a paused run, experiment, module, workcell or lab",
    example={"target": "rpl/ot2_pcr_alpha", "by": "ada"},
)
async def resume(call: Call, body: ControlRequest) -> ControlResult:
    return await control(call.kernel, "resume", body)


@_control(
    route="POST /control/cancel",
    summary="Cancel a run, an experiment, or the runs of a module, a workcell or the lab",
    example={"target": "R1", "by": "ada", "why": "wrong plate"},
    example_answer={"kind": "run", "target": "R1", "runs": ["R1"]},
)
async def cancel(call: Call, body: ControlRequest) -> ControlResult:
    """With a module, the started runs that still need it are cancelled; with a workcell or the lab, all runs,
    also those that wait. A cancelled experiment accepts no more runs and closes when its runs have ended.
    Closing workflows continue, because they clear labware away."""
    return await control(call.kernel, "cancel", body)


def recall_stop(events: list[Event]) -> StopReport:
    """The answer to an earlier stop of modules: nothing is stopped again."""
    (report,) = (event for event in events if isinstance(event, StopReported))
    return StopReport(report.stopped, report.silent)


@Operation(
    route="POST /estop",
    recall=recall_stop,
    client=Method("emergency_stop", "target, by='somebody'", repeat=True, timeout_s=5.0),
    summary="Stop modules at once, in an emergency",
    needs="submitter",
    by_home=True,
    problems=("not_found",),
    example={"target": "*", "by": "ada"},
    example_answer={
        "stopped": {"rpl/pf400": 1767225600000000000},
        "silent": {"rpl/ur5": "no node answers for it"},
    },
)
async def stop_modules(call: Call, body: EmergencyStop) -> StopReport:
    """The stop does not wait for the log; it is logged afterwards. It is not a safety function. `stopped` are
    the modules that confirmed the stop, with the time (UTC nanoseconds); `silent` are the others. A stopped
    module is in the state ERROR until a run of its action `reset`, which `labos reset` submits."""
    return await call.service.emergency_stop(body.target, name_in_emergency(body.said_by))
