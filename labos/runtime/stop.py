"""Emergency stops: directly over the bus to the nodes, without kernel, fencing or log.

A node reports the stop with its state until it is reset; the kernel records it from there. A stop by software
is a convenience and not a safety function.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

import msgspec

from labos.core.ids import ModuleName, local, workcell_of
from labos.core.texts import cut
from labos.errors import BusError, NoAnswer, Unreadable
from labos.node.limits import REPLY_LIMIT, read
from labos.node.protocol import AdminReply, AdminRequest, Keys
from labos.ports import Bus

_reply = msgspec.json.Decoder(AdminReply)

EVERYTHING = "*"

ANSWER_S = 3.0
"""How long a node may take to confirm that it has stopped."""


class StopReport(msgspec.Struct, frozen=True):
    """``stopped`` are the modules whose nodes confirmed the stop, with the time (UTC ns). ``silent`` are
    those that did not, each with a reason."""

    stopped: dict[ModuleName, int] = {}
    silent: dict[ModuleName, str] = {}


def resolve_target(target: str, modules: Iterable[ModuleName]) -> list[ModuleName]:
    """The modules that a target names: one of them by its full or local name, all of a workcell, or
    everything (``*``). If several modules have one name, all of them are stopped."""
    return [
        module
        for module in modules
        if target in (EVERYTHING, str(module), local(module), workcell_of(module))
    ]


async def stop_modules(bus: Bus, lab: str, modules: Iterable[ModuleName], by: str) -> StopReport:
    """Stop modules, all at once."""
    names = list(modules)
    answers = await asyncio.gather(*(_stop(bus, lab, module, by) for module in names))
    pairs = list(zip(names, answers, strict=True))
    return StopReport(
        {module: answer for module, answer in pairs if isinstance(answer, int)},
        {module: answer for module, answer in pairs if isinstance(answer, str)},
    )


async def _stop(bus: Bus, lab: str, module: ModuleName, by: str) -> int | str:
    """The time at which the module was stopped, or why that is not known."""
    request = msgspec.json.encode(AdminRequest(lab, 0, "estop", {"by": by}))
    try:
        answer = await bus.query(Keys(lab).operation(module, "admin"), request, ANSWER_S)
        reply = read(answer, _reply, whose="its node", limit=REPLY_LIMIT)
    except Unreadable as error:
        return error.message.rstrip(".")
    except NoAnswer:
        return "no node answers for it"
    except BusError as error:  # an error at one module must not prevent the stop of the others
        return str(error)
    if not reply.done or not isinstance(reply.result, int) or not 0 <= reply.result < 2**63:
        return cut(reply.why) or "its node does not confirm it"
    return reply.result
