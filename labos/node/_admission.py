"""Which requests a node accepts: those of its own lab and its newest kernel, with values that a kernel can
send.

A single message must not put a module out of work permanently. So an epoch or a position that is far above
all that the node has seen is refused, and is not stored.
"""

from __future__ import annotations

from typing import Literal

from labos.errors import BadInput
from labos.node.journal import Journal
from labos.node.limits import cut, find_flaw, is_name
from labos.node.protocol import (
    ATTEMPT_JUMP,
    EPOCH_JUMP,
    GREATEST,
    POSITION_JUMP,
    Acknowledge,
    ActionMessage,
    Ask,
    Start,
)


class NotAdmitted(BadInput):
    """A request that the node refuses. ``fenced``: it is from another lab, or from an older kernel."""

    def __init__(self, message: str, status: Literal["fenced", "refused"], *, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.status: Literal["fenced", "refused"] = status


class Admission:
    """The admission of requests for one module in the lab ``lab``."""

    def __init__(self, module: str, lab: str, journal: Journal) -> None:
        self._module, self._lab = module, lab
        self._journal, self._memory = journal, journal.memory

    def admit(self, lab: str, epoch: int) -> None:
        """Bind the node to its lab and to the kernel of this epoch. Raises NotAdmitted."""
        memory = self._memory
        if lab != (memory.lab or self._lab):
            mine = memory.lab or self._lab
            raise NotAdmitted(f"{self._module} belongs to lab {mine}, not to {cut(lab, 80)}.", "fenced")
        if epoch < memory.epoch:
            raise NotAdmitted(
                f"{self._module} obeys the kernel of epoch {memory.epoch}; this one's is {epoch}.", "fenced"
            )
        if epoch > min(memory.epoch + EPOCH_JUMP, GREATEST):
            raise NotAdmitted(
                f"{self._module} obeys the kernel of epoch {memory.epoch}; no kernel of its lab can have "
                f"epoch {epoch}.",
                "refused",
                remedy="Nothing was changed; find the program that sends this.",
            )
        self._journal.bind(lab)
        self._journal.raise_epoch(epoch)

    def check(self, message: ActionMessage) -> None:
        """Check that a kernel can have sent this message. Nothing is stored. Raises NotAdmitted."""
        if flaw := self._find_flaw(message):
            raise NotAdmitted(f"No kernel sends such a message to {self._module}: {flaw}.", "refused")

    def check_position(self, position: object) -> int:
        """A position that a kernel can have sent. Raises NotAdmitted."""
        if type(position) is not int or not 0 <= position <= GREATEST:
            raise NotAdmitted(
                f"Not a position of a log: {cut(repr(position), 80)}.",
                "refused",
                remedy="Nothing was changed.",
            )
        return position

    def _find_flaw(self, message: ActionMessage) -> str:
        match message:
            case Acknowledge(position=position):
                return self._find_flaw_of_acknowledgement(position)
            case Ask():
                return self._find_flaw_of_request(message)
            case Start():
                if flaw := find_flaw(message.args, limit=GREATEST):
                    return f"its arguments cannot be accepted, {flaw}"
                return self._find_flaw_of_request(message)

    def _find_flaw_of_request(self, message: Start | Ask) -> str:
        if not is_name(message.action):
            return f"not a name of an action: {cut(repr(message.action), 80)}"
        if not 1 <= message.position <= GREATEST:
            return f"not a position of a log: {message.position}"
        last = self._memory.find_last_attempt(message.action)
        if not 1 <= message.attempt <= last + ATTEMPT_JUMP:
            return f"attempt {message.attempt} of {message.action} cannot follow attempt {last}"
        return ""

    def _find_flaw_of_acknowledgement(self, position: int) -> str:
        if not 0 <= position <= GREATEST:
            return f"not a position of a log: {position}"
        if position > self._memory.seen + POSITION_JUMP:
            return f"position {position} is too far behind the last request, which has {self._memory.seen}"
        return ""
