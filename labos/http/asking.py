"""Whether modules can work now: each node is asked over the bus, and what it says is told as it is."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import msgspec

from labos.core.ids import ModuleName
from labos.errors import NoAnswer, NotFound, Unreadable
from labos.node.protocol import Keys
from labos.runtime.hearing import read_state

if TYPE_CHECKING:
    from labos.http.service import LabService

ANSWER_S = 2.0
"""How long a node may take to answer: it does nothing but say what it knows."""

PROCESS_LIVES = ("starting", "running")


class Heard(msgspec.Struct, frozen=True):
    """What a module's node answered just now. ``IDLE``, ``BUSY`` and ``ERROR`` are its own words,
    ``ERROR`` also if its device is off or does not answer, as ``why`` tells; ``silent``: there is no
    node; ``frozen``: there is one, and it does not answer; ``locked``: it takes no actions;
    ``refused``: the lab does not admit it; ``out``: it answers, and is out of service;
    ``absent``: this lab has no such module."""

    name: ModuleName
    answer: Literal["IDLE", "BUSY", "ERROR", "silent", "frozen", "locked", "refused", "out", "absent"]
    why: str = ""


async def ask_nodes(service: LabService, modules: Sequence[str]) -> list[Heard]:
    """Ask the nodes of these modules, or of all, at once. Raises BadInput for a name that several
    modules bear."""
    names = list(modules) or list(map(str, service.kernel.state.modules.by_name))
    return list(await asyncio.gather(*(_ask(service, name) for name in names)))


async def _ask(service: LabService, asked: str) -> Heard:
    try:
        name = service.module(asked)
    except NotFound as error:
        return Heard(ModuleName(asked), "absent", str(error))
    registry, module = service.parts.registry, service.kernel.state.modules.by_name[name]
    try:
        answer = await service.parts.bus.query(Keys(registry.lab).operation(name, "state"), b"{}", ANSWER_S)
        state = read_state(answer, "its node")
    except Unreadable as error:
        return Heard(name, "refused", error.message.rstrip("."))
    except NoAnswer:
        return _unanswered(service, name)
    if name in registry.rejected:
        return Heard(name, "refused", registry.rejected[name])
    if state.status == "ERROR":
        return Heard(name, "ERROR", state.error)
    if module.out_of_service:
        return Heard(name, "out", module.out_of_service)
    if state.locked:
        return Heard(name, "locked", "its node takes no actions until it is unlocked")
    return Heard(name, "BUSY" if module.busy else state.status)


def _unanswered(service: LabService, name: ModuleName) -> Heard:
    """A node that is gone, or one that is there and does not answer."""
    supervised = service.parts.supervised
    process = supervised.nodes.get(name) if supervised is not None else None
    if process is not None and process.state in PROCESS_LIVES and process.pid:
        return Heard(name, "frozen", f"its process {process.pid} is there and does not answer")
    if name in service.parts.registry.living:
        return Heard(name, "frozen", f"its node is on the bus and does not answer within {ANSWER_S:g} s")
    return Heard(name, "silent", "no node answers for it (gone or frozen)")
