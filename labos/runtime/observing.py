"""Observations of modules: asks nodes to ``observe``, and translates their answers to the names of the
log."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from labos.core.ids import LabId, LabwareId, ModuleName, StationName, local, workcell_of
from labos.core.modules import ModuleStatus
from labos.core.state import LabState
from labos.core.texts import cut
from labos.errors import NoAnswer
from labos.node.limits import REPLY_LIMIT, read
from labos.node.protocol import AdminReply, AdminRequest, Keys
from labos.ports import Bus
from labos.runtime.kernel import Kernel
from labos.runtime.ledger import Entry
from labos.runtime.tasks import KernelPart

Name = TypeVar("Name", bound=str)

_encode = msgspec.json.Encoder().encode
_reply = msgspec.json.Decoder(AdminReply)

MOST_SEEN = 10_000
"""A count that no station reaches."""


class Observer:
    """Asks modules for one kernel. ``answer_s`` is how long a node may take to answer."""

    def __init__(self, kernel: Kernel, bus: Bus, answer_s: float) -> None:
        self._kernel, self._bus, self._answer_s = kernel, bus, answer_s

    def explain_cannot_ask(self, module: ModuleName) -> str:
        """Why a module cannot be asked now; empty if it can. A module that still moves cannot observe."""
        known = self._kernel.state.modules.by_name.get(module)
        if known is None:
            return "it does not exist"
        return "" if known.status in (ModuleStatus.IDLE, ModuleStatus.ERROR) else f"it is {known.status}"

    async def observe(self, module: ModuleName) -> dict[StationName, Any]:
        """The observations of a module, by station. Raises BusError if it does not answer, StoreError."""
        seen = (await observe_module(self._kernel, self._bus, module, self._answer_s)).get("labware")
        sights = seen if isinstance(seen, Mapping) else {}
        return {resolve_station(module, str(place)): sight for place, sight in sights.items()}


class ObservingPart(KernelPart, ABC, Generic[Name]):
    """Starts observations after events, one task for each name. ``answer_s`` is how long a node may take to
    answer; ``observed`` is the number of observations."""

    def __init__(self, kernel: Kernel, bus: Bus, *, answer_s: float = 5.0) -> None:
        super().__init__(kernel)
        self._observer = Observer(kernel, bus, answer_s)
        self.observed = 0

    async def start(self) -> None:
        """Observe from now on, and at once for everything that is open already."""
        await super().start()
        self.on_reopened()

    @abstractmethod
    def on_committed(self, entries: Sequence[Entry]) -> None: ...

    @abstractmethod
    def on_reopened(self) -> None: ...

    @abstractmethod
    async def _observe(self, name: Name) -> None: ...

    def _observe_soon(self, name: Name) -> None:
        self._tasks.spawn_once(name, partial(self._observe, name))


class Requester(Protocol):
    """The sender of a request to a node."""

    @property
    def lab(self) -> LabId: ...

    @property
    def epoch(self) -> int: ...


async def observe_module(
    kernel: Requester, bus: Bus, module: ModuleName, answer_s: float
) -> Mapping[str, Any]:
    """The observations of a module's device: variables by name, ``labware`` by station. Raises BusError if
    its node does not answer, StoreError."""
    request = AdminRequest(kernel.lab, kernel.epoch, "observe", {})
    key = Keys(kernel.lab).operation(module, "admin")
    payload = await bus.query(key, _encode(request), answer_s)
    reply = read(payload, _reply, whose=str(module), limit=REPLY_LIMIT)
    if not reply.done:
        raise NoAnswer(f"{module} cannot look: {cut(reply.why)}")
    return reply.result if isinstance(reply.result, Mapping) else {}


def resolve_station(module: ModuleName, place: str) -> StationName:
    """The station for a name that a node uses: its own ``nest``, or ``sealer.default`` of another module."""
    bare = local(place)
    return StationName(f"{workcell_of(module)}/{bare}" if "." in bare else f"{module}.{bare}")


def read_contents(state: LabState, what: Any) -> tuple[int | None, LabwareId] | None:
    """A node's observation of a station: whether there is something, how much, or a barcode. Returns the
    count (null: at least one) and the labware with this barcode. None if the node cannot tell."""
    if isinstance(what, bool):
        return (None if what else 0), LabwareId("")
    if isinstance(what, int):
        return (what, LabwareId("")) if 0 <= what <= MOST_SEEN else None
    if isinstance(what, str):
        return None, state.bench.barcodes.get(what, LabwareId(""))
    return None
