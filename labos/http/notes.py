"""What the kernel's process knows of nodes besides the log: why some are not admitted; their processes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    from labos.http.service import LabService


class ProcessNote(msgspec.Struct, frozen=True):
    """The process of a node, as the kernel's process has it."""

    state: str
    pid: int
    starts: int
    failures: int
    why: str


class Notes(msgspec.Struct, frozen=True):
    """``rejected`` says why nodes are not admitted, ``supervised`` are those that run here, both by module;
    ``suspended`` why nothing is started; ``simulated``: the bench is a simulated one."""

    rejected: Mapping[str, str] = {}
    supervised: Mapping[str, ProcessNote] = {}
    suspended: str = ""
    simulated: bool = False


def notes_of(service: LabService) -> Notes:
    """What is known in the kernel's own process."""
    parts = service.parts
    nodes = parts.supervised.nodes if parts.supervised is not None else {}
    return Notes(
        {str(name): why for name, why in parts.registry.rejected.items()},
        {name: ProcessNote(p.state, p.pid, p.starts, p.failures, p.why) for name, p in nodes.items()},
        service.kernel.suspended,
        parts.simulated,
    )
