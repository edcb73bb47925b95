"""The interface of the kernel for operations: the kernel is in this process, or it is followed."""

from __future__ import annotations

import asyncio
from typing import Protocol

from labos.clock import Clock, Ids
from labos.core.decide import Command, Rejection
from labos.core.ids import LabId
from labos.core.registry import Event
from labos.core.state import LabState
from labos.errors import LabosError
from labos.planning.scheduler import Scheduler
from labos.runtime.kernel_log import Listener


class LabKernel(Protocol):
    """The kernel itself, or ``FollowedKernel`` in a process of its own."""

    @property
    def state(self) -> LabState: ...

    @property
    def durable(self) -> int: ...

    @property
    def lab(self) -> LabId: ...

    @property
    def epoch(self) -> int: ...

    @property
    def clock(self) -> Clock: ...

    @property
    def ids(self) -> Ids: ...

    @property
    def listeners(self) -> list[Listener]: ...

    @property
    def failed(self) -> asyncio.Future[LabosError]: ...

    @property
    def suspended(self) -> str: ...

    @property
    def scheduler(self) -> Scheduler: ...

    async def flush(self) -> None: ...

    async def execute(self, command: Command, actor: str, causation: str = "") -> list[Event]: ...

    async def scrub(self) -> str:
        """Remove what remains of erased words from the database's files. Returns why something may still
        remain."""

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection: ...
