"""Whether modules can work now: each node is asked over the bus, and its answer is passed on unchanged."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from labos.core.ids import ModuleName, local
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import BusError, NoAnswer, NotFound, Refused, Unreadable
from labos.http.views import OldName
from labos.node.limits import read
from labos.node.protocol import AdminReply, AdminRequest, Keys
from labos.runtime.incoming import read_about, read_state
from labos.runtime.observing import observe_module

if TYPE_CHECKING:
    from labos.http.service import LabService

ANSWER_S = 2.0
"""How long a node may take to answer; it answers from memory."""

LOOK_S = 5.0
"""How long a node may take to look at its device."""

_reply = msgspec.json.Decoder(AdminReply)

PROCESS_LIVES = ("starting", "running")


class NodeCheck(msgspec.Struct, frozen=True):
    """The node's description of itself and its device: the driver and its version, its versions of LabOS and
    of the node protocol, the serial number to which it is pinned, and the version that the device reports
    (both may be empty). Then the device's present readings, or why there are none. Then how many seconds the
    clock of the node's host is ahead of the kernel's (uncertain by half the time of the answer; None if it is
    not reported)."""

    driver: str
    version: str
    labos: str
    protocol: int
    simulated: bool
    unit: str
    firmware: str
    sees: dict[str, Any] = {}
    sees_nothing: str = ""
    clock_ahead_s: float | None = None


class NodeAnswer(msgspec.Struct, frozen=True):
    """The present answer of a module's node. ``IDLE``, ``BUSY`` and ``ERROR`` are states that the node
    reports; ``ERROR`` also if its device is off or does not answer (see ``why``). ``silent``: there is no
    node; ``frozen``: there is one, but it does not answer; ``refused``: the lab does not admit it; ``out``:
    its node answers, but the module is out of service; ``absent``: this lab has no such module. ``checked``
    is present if it was requested and the node answered."""

    module: ModuleName
    answer: Literal["IDLE", "BUSY", "ERROR", "silent", "frozen", "refused", "out", "absent"]
    why: str = ""
    checked: NodeCheck | None = None
    name: OldName = ""

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "name", self.module)


async def ask_nodes(service: LabService, modules: Sequence[str], *, check: bool = False) -> list[NodeAnswer]:
    """Ask the nodes of these modules, or of all, at the same time. With ``check``, each also reports its
    versions and its device's readings. Nothing moves. Raises BadInput for a name that several modules
    have."""
    names = list(modules) or list(map(str, service.kernel.state.modules.by_name))
    heard = await asyncio.gather(*(_ask(service, name) for name in names))
    if not check:
        return list(heard)
    return list(await asyncio.gather(*(_check(service, one) for one in heard)))


async def _check(service: LabService, heard: NodeAnswer) -> NodeAnswer:
    if heard.answer in ("silent", "frozen", "absent"):
        return heard
    keys, bus = Keys(service.parts.registry.lab), service.parts.bus
    clock = service.kernel.clock
    asked_ns = clock.now_ns()
    try:
        answer = await bus.query(keys.operation(heard.module, "about"), b"{}", ANSWER_S)
        heard_ns = clock.now_ns()
        about = read_about(answer, "its node")
    except BusError as error:
        return msgspec.structs.replace(heard, why=heard.why or error.message)
    sees: dict[str, Any] = {}
    fault = ""
    try:
        sees = dict(await observe_module(service.kernel, bus, heard.module, LOOK_S))
    except BusError as error:
        fault = error.message
    description = about.description
    checked = NodeCheck(
        driver=cut(str(description.get("driver", "")), LONGEST_NAME),
        version=cut(str(description.get("version", "")), LONGEST_NAME),
        labos=cut(about.labos, LONGEST_NAME),
        protocol=about.protocol,
        simulated=about.simulated,
        unit=cut(about.unit, LONGEST_NAME),
        firmware=cut(about.firmware, LONGEST_NAME),
        sees=sees,
        sees_nothing=fault,
        clock_ahead_s=_measure_ahead_s(about.now_ns, asked_ns, heard_ns),
    )
    return msgspec.structs.replace(heard, checked=checked)


def _measure_ahead_s(node_ns: int, asked_ns: int, heard_ns: int) -> float | None:
    """How far a node's clock is ahead, if the node answered in the middle between question and answer."""
    return (node_ns - (asked_ns + heard_ns) // 2) / 1e9 if node_ns else None


async def switch_trace(service: LabService, module: ModuleName, on: bool) -> str:
    """Start or stop the transcript of a device's links; returns its file on the node's computer. Raises
    Refused, also if no node answers."""
    request = AdminRequest(service.parts.registry.lab, service.kernel.epoch, "trace", {"on": on})
    key = Keys(service.parts.registry.lab).operation(module, "admin")
    try:
        reply = read(await service.parts.bus.query(key, msgspec.json.encode(request), ANSWER_S), _reply)
    except BusError:
        raise Refused(
            f"No node answers for {local(module)} (gone or frozen).", remedy="See labos nodes --check."
        ) from None
    if not reply.done:
        raise Refused(cut(reply.why))
    return cut(str(reply.result), LONGEST_NAME)


async def _ask(service: LabService, asked: str) -> NodeAnswer:
    try:
        name = service.module(asked)
    except NotFound as error:
        return NodeAnswer(ModuleName(asked), "absent", str(error))
    registry, module = service.parts.registry, service.kernel.state.modules.by_name[name]
    try:
        answer = await service.parts.bus.query(Keys(registry.lab).operation(name, "state"), b"{}", ANSWER_S)
        state = read_state(answer, "its node")
    except Unreadable as error:
        return NodeAnswer(name, "refused", error.message.rstrip("."))
    except NoAnswer:
        return _explain_silence(service, name)
    if name in registry.rejected:
        return NodeAnswer(name, "refused", registry.rejected[name])
    if state.status == "ERROR":
        return NodeAnswer(name, "ERROR", state.error)
    if module.out_of_service:
        return NodeAnswer(name, "out", module.out_of_service)
    return NodeAnswer(name, "BUSY" if module.busy else state.status)


def _explain_silence(service: LabService, name: ModuleName) -> NodeAnswer:
    """The answer for a node that is gone, or that is present but does not answer."""
    supervised = service.parts.supervised
    process = supervised.nodes.get(name) if supervised is not None else None
    if process is not None and process.state in PROCESS_LIVES and process.pid:
        return NodeAnswer(name, "frozen", f"its process {process.pid} is running but does not answer")
    if name in service.parts.registry.living:
        return NodeAnswer(name, "frozen", f"its node is on the bus but does not answer within {ANSWER_S:g} s")
    return NodeAnswer(name, "silent", "no node answers for it (gone or frozen)")
