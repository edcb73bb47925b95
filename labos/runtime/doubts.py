"""Messages that are not accepted: written to the process's log, and reported to a person once."""

from __future__ import annotations

import structlog

from labos.core.decide.nodes import DoubtNode, OutrankNode
from labos.core.ids import ModuleName
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import LabosError, StoreError
from labos.runtime.incoming import RateLimiter
from labos.runtime.kernel import Kernel

ASK_AGAIN_S = 3600.0
"""After a person has answered, no question about the same module is asked for so long."""

LOG_AGAIN_S = 10.0

_log = structlog.get_logger(__name__)


class Doubts:
    """Reports messages that a kernel does not accept. Many of them cause only one question for each module,
    and a line in the process's log every ``LOG_AGAIN_S``."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._questions = RateLimiter(kernel.clock, ASK_AGAIN_S)
        self._outranked = RateLimiter(kernel.clock, ASK_AGAIN_S)
        self._lines = RateLimiter(kernel.clock, LOG_AGAIN_S)
        self._left_out = 0

    def note(self, what: str, module: str, why: str) -> None:
        """Write a line to the process's log, unless there was one about this module just before. All modules
        that the lab does not have count as one."""
        if not self._lines.spend(module if self.has(module) else ""):
            self._left_out += 1
            return
        _log.warning(what, module=cut(module, LONGEST_NAME), why=why, left_out=self._left_out)
        self._left_out = 0

    def ask(self, module: ModuleName, why: str) -> None:
        """Report to a person that a message in a module's name is not accepted."""
        self.note("not_believed", module, why)
        if self.has(module) and self._questions.spend(module):
            self._submit(DoubtNode(module, why), module)

    def outrank(self, module: ModuleName, epoch: int) -> None:
        """Report to a person that a node obeys a later kernel, and stop using its module."""
        if self._outranked.spend(module):
            self._submit(OutrankNode(module, epoch), module)

    def has(self, module: str) -> bool:
        """Whether a workcell of the lab has this module, as far as is known now."""
        try:
            return module in self._kernel.state.modules.by_name
        except StoreError:
            return False

    def _submit(self, command: DoubtNode | OutrankNode, module: ModuleName) -> None:
        try:
            self._kernel.submit(command, str(module))
        except LabosError as error:
            _log.warning("question_not_asked", module=module, why=str(error))
