"""Facts about nodes that the kernel's process knows and the log does not have: why some are not admitted, and
their processes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import msgspec

from labos.core.structs import make_from

if TYPE_CHECKING:
    from labos.http.service import LabService


class ProcessNote(msgspec.Struct, frozen=True):
    """The process of a node, as the kernel's process knows it."""

    state: str
    pid: int
    starts: int
    failures: int
    why: str


class Notes(msgspec.Struct, frozen=True):
    """``rejected`` has the reasons why nodes are not admitted, ``supervised`` the nodes that run here, both
    by module; ``suspended`` is the reason why nothing is started; ``simulated``: the bench is simulated."""

    rejected: Mapping[str, str] = {}
    supervised: Mapping[str, ProcessNote] = {}
    suspended: str = ""
    simulated: bool = False


def notes_of(service: LabService) -> Notes:
    """The facts in the kernel's own process."""
    parts = service.parts
    nodes = parts.supervised.nodes if parts.supervised is not None else {}
    return Notes(
        {str(name): why for name, why in parts.registry.rejected.items()},
        {name: make_from(ProcessNote, process) for name, process in nodes.items()},
        service.kernel.suspended,
        parts.simulated,
    )
