"""Modules and workcells: actions of people on them, and access."""

from __future__ import annotations

import asyncio

import msgspec

from labos.core.decide.calibrations import CalibrateModule
from labos.core.decide.nodes import PutBack, TakeOut
from labos.core.ids import workcell_of
from labos.core.structs import make_from
from labos.errors import BadInput
from labos.http.access import end_access, request_access
from labos.http.asking import switch_trace
from labos.http.bodies import (
    AccessEnd,
    AccessRequest,
    By,
    NewCalibration,
    NewPose,
    OutOfService,
    WireTrace,
    WorkcellFile,
)
from labos.http.limits import LARGEST_BODY
from labos.http.operation import Call, Method, apply_file, operate, read
from labos.http.queries import OfModule, OfWorkcell
from labos.http.stock import Replenishment, check, replenish
from labos.http.teaching import LocationPose, make_locations, teach
from labos.http.workcells import WorkcellChange, apply_workcell


class ModuleReference(msgspec.Struct, frozen=True):
    module: str


class TraceFile(msgspec.Struct, frozen=True):
    """The transcript: a file on the node's computer. The node chooses its name."""

    module: str
    file: str


class ReplenishResult(msgspec.Struct, frozen=True):
    """The amount that was put in."""

    module: str
    resource: str
    amount: float


class Locations(msgspec.Struct, frozen=True):
    locations: dict[str, LocationPose]


class PoseVersion(msgspec.Struct, frozen=True):
    version: int


class CalibrationRecord(msgspec.Struct, frozen=True):
    """The recorded calibration. ``file`` is the SHA-256 of its report; empty if none was sent."""

    module: str
    what: str
    certificate: str
    file: str
    until: str


class AccessResult(msgspec.Struct, frozen=True):
    """``parking`` are the runs that first move arms to their rest positions."""

    workcell: str
    parking: list[str]


class WorkcellReference(msgspec.Struct, frozen=True):
    workcell: str


_CELL = "labos: 1\nname: bench\nmodules:\n  - {name: sealer, model: A4S_sealer}\n"


@operate(
    route="POST /modules/{module}/out-of-service",
    client=Method("take_out", "module, why, by, until_ns=until", take=None),
    summary="Take a module out of service",
    example={"why": "new foil", "by": "ada"},
    example_answer={"module": "rpl/sealer"},
)
async def take_out_of_service(call: Call, path: OfModule, body: OutOfService) -> ModuleReference:
    """Actions under way continue to their end; nothing more starts there."""
    if not body.why.strip():
        raise BadInput("The field 'why' is empty.", remedy="Give the reason.")
    module = call.service.module(path.module)
    await call.kernel.execute(TakeOut(module, body.why, body.until, call.kernel.clock.now_ns()), body.by)
    return ModuleReference(path.module)


@operate(
    route="POST /modules/{module}/in-service",
    client=Method("put_back", "module, by='somebody'", take=None, repeat=True),
    summary="Put a module back in service",
    example={"by": "ada"},
    example_answer={"module": "rpl/sealer"},
)
async def put_in_service(call: Call, path: OfModule, body: By) -> ModuleReference:
    await call.kernel.execute(PutBack(call.service.module(path.module)), body.by)
    return ModuleReference(path.module)


@operate(
    route="POST /modules/{module}/trace",
    client=Method("trace", "module, by='somebody'", take="file", repeat=True),
    summary="Start or stop the transcript of a device's links",
    example={"by": "ada", "on": True},
    example_answer={"module": "rpl/sealer", "file": "/lab/traces/sealer.jsonl"},
)
async def trace_wires(call: Call, path: OfModule, body: WireTrace) -> TraceFile:
    """The module's node records every byte on the links to its device, or stops doing so
    ([links](../links.md))."""
    module = call.service.module(path.module)
    call.service.expect_role(body.by, "operator", workcell_of(module))
    return TraceFile(module, await switch_trace(call.service, module, body.on))


@operate(
    route="POST /modules/{module}/replenish",
    client=Method("replenish", take="amount"),
    summary="Report that a resource was refilled",
    problems=("refused", "spec_error"),
    example={"resource": "foil", "by": "ada", "amount": 96, "lot": "F7"},
    example_answer={"module": "rpl/sealer", "resource": "foil", "amount": 96},
)
async def replenish_resource(call: Call, path: OfModule, body: Replenishment) -> ReplenishResult:
    """An amount larger than the free room is refused."""
    amount = await replenish(call.service, path.module, body, body.by)
    return ReplenishResult(path.module, body.resource, amount)


@read(
    route="GET /modules/{module}/locations",
    client=Method("locations", take="locations"),
    summary="Show the poses of a manipulator by station",
    example_answer={
        "locations": {"sealer.default": {"pose": [190.1], "version": 2, "proven": True, "types": {}}}
    },
)
async def list_locations(call: Call, path: OfModule) -> Locations:
    """Version 0 is the pose of the workcell file. Poses for particular labware types are under `types`."""
    name = call.service.module(path.module)
    return Locations(make_locations(call.kernel.state.modules.by_name[name]))


@operate(
    route="POST /modules/{module}/locations",
    client=Method("teach", "module, station, pose, by, why", take="version", repeat=True),
    summary="Teach a manipulator the pose for a station",
    status=201,
    example={"station": "sealer.default", "pose": [190.1], "by": "ada", "why": "moved"},
    example_answer={"version": 3},
)
async def teach_location(call: Call, path: OfModule, body: NewPose) -> PoseVersion:
    """The node restarts with the new pose."""
    return PoseVersion(await teach(call.service, path.module, body, body.by))


@operate(
    route="POST /modules/{module}/calibrations",
    client=Method("calibrate", "module, by", key="new"),
    summary="Record a calibration of a module",
    status=201,
    example={"by": "ada", "what": "volume", "certificate": "K-2041", "until": "2027-01-01"},
    example_answer={
        "module": "rpl/ot2_cp_gamma",
        "what": "volume",
        "certificate": "K-2041",
        "file": "",
        "until": "2027-01-01",
    },
    largest_body=LARGEST_BODY,
)
async def calibrate_module(call: Call, path: OfModule, body: NewCalibration) -> CalibrationRecord:
    """A later calibration of the same `what` replaces it. No run waits for a calibration, and none stops
    because a calibration has expired. `/files/{sha256}` returns the report."""
    command = make_from(CalibrateModule, body, module=call.service.module(path.module))
    if body.report:
        check(call.service, command, body.by)  # a refused request must not leave a file behind
        file = await asyncio.to_thread(call.service.parts.blobs.put, body.report)
        command = msgspec.structs.replace(command, file=file)
    await call.kernel.execute(command, body.by)
    return make_from(CalibrationRecord, command)


@apply_file(
    route="POST /workcells",
    client=Method("apply_workcell", by_hand=True),
    summary="Apply a workcell file",
    tag="workcells",
    example={"text": _CELL, "by": "ada", "name": "bench.yaml", "dry_run": True},
    largest_body=LARGEST_BODY,
)
async def change_workcell(call: Call, body: WorkcellFile) -> WorkcellChange:
    """The answer has the differences (`modules`, `stations`, `poses`, `labware`), the changed fields of each
    module (`details`), the `blockers`, the warnings about its files (`findings`), and whether it was
    `applied`. The request reads no file from the lab's disk. A module that names files, programs or secrets
    of its node's computer ([workcell](workcell.md#files-programs-and-secrets)) is refused unless the lab has
    the same module already."""
    return await apply_workcell(call.service, body, body.by)


@operate(
    route="POST /workcells/{workcell}/access",
    client=Method("enter", "workcell, by, why", take="parking", repeat=True),
    summary="Request access to a workcell",
    tag="workcells",
    status=201,
    example={"by": "ada", "why": "a plate is askew"},
    example_answer={"workcell": "rpl", "parking": ["R7"]},
)
async def request_workcell_access(call: Call, path: OfWorkcell, body: AccessRequest) -> AccessResult:
    """Nothing more starts there. `lab.access` in the state shows when access is `granted`, and which modules
    may still be moving because the outcome of their action is unknown (`perhaps_moving`)."""
    runs = await request_access(call.service, path.workcell, body.by, body.why, park=body.park)
    return AccessResult(path.workcell, runs)


@operate(
    route="POST /workcells/{workcell}/access/end",
    client=Method("leave", by_hand=True),
    summary="End the access to a workcell",
    tag="workcells",
    example={"by": "ada", "changed": [{"station": "sealer.default", "what": "empty"}]},
    example_answer={"workcell": "rpl"},
)
async def end_workcell_access(call: Call, path: OfWorkcell, body: AccessEnd) -> WorkcellReference:
    """No person works in the workcell any more, and it continues."""
    await end_access(call.service, path.workcell, body.by, body.note, body.changed)
    return WorkcellReference(path.workcell)
