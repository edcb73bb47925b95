"""Finds actions that nodes have carried out and the log does not have: it compares their journals with the
log."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence

import structlog

from labos.core.decide.nodes import HearJournal
from labos.core.decide.shorter import MANY_FOUND, FoundAction
from labos.core.ids import ActionId, ModuleName
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import BusError, LabosError
from labos.node.protocol import GREATEST, AboutReport, StateReport, Unacknowledged
from labos.runtime.incoming import RateLimiter
from labos.runtime.kernel import Kernel
from labos.runtime.tasks import Tasks

MOST_LOOKED_FOR = 5000
"""At most so many entries of one journal are searched for in the log."""

_log = structlog.get_logger(__name__)


class Discovery:
    """Compares heartbeats and journals with one kernel's log. ``ask_about`` asks a node for its description,
    which includes its journal's entries; it raises BusError."""

    def __init__(
        self, kernel: Kernel, ask_about: Callable[[ModuleName], Awaitable[AboutReport]], tasks: Tasks
    ) -> None:
        self._kernel, self._ask_about, self._tasks = kernel, ask_about, tasks
        self._looks = RateLimiter(kernel.clock, 1.0, 5)
        self._looked_for: dict[ModuleName, frozenset[ActionId]] = {}
        self._in_log: dict[ModuleName, set[ActionId]] = {}

    async def find_unlogged(self, module: ModuleName, entries: Sequence[Unacknowledged]) -> list[FoundAction]:
        """The actions in a node's journal that are not in the log. An action that ended long ago is no longer
        in memory, but its request is in the log. Raises StoreError."""
        found: dict[ActionId, FoundAction] = {}
        for entry in entries[:MOST_LOOKED_FOR]:
            name = ActionId(entry.action)
            if self._is_known(module, name):
                continue
            if await self._kernel.holds_request(name, entry.position):
                self._in_log.setdefault(module, set()).add(name)
                continue
            short = ActionId(cut(name, LONGEST_NAME))
            name_ = cut(entry.name, LONGEST_NAME)
            position = entry.position if 0 <= entry.position < GREATEST else 0
            found[short] = FoundAction(short, name_, entry.status, position, entry.effects)
            if len(found) >= MANY_FOUND:
                break
        return list(found.values())

    def compare(self, module: ModuleName, report: StateReport) -> None:
        """Ask a node for its journal if its heartbeat names an action that is not in memory. The same list of
        such names causes only one request, because anybody can publish a heartbeat. Raises StoreError."""
        named = {ActionId(name) for name in (*report.running, *report.finished, *report.interrupted)}
        if module in self._in_log:
            self._in_log[module] &= named
        discovered = self._kernel.state.actions.discovered
        strange = frozenset(
            name
            for name in named
            if not self._is_known(module, name) and cut(name, LONGEST_NAME) not in discovered
        )
        if not strange:
            self._looked_for.pop(module, None)
        elif strange != self._looked_for.get(module) and self._looks.spend(module):
            self._looked_for[module] = strange
            self._tasks.spawn(self._look(module))

    async def _look(self, module: ModuleName) -> None:
        try:
            about = await self._ask_about(module)
            known = self._kernel.state.modules.by_name.get(module)
            if known is None or (known.instance, known.journal) != (about.instance, about.journal):
                return
            found = await self.find_unlogged(module, about.open)
            if found:
                self._kernel.submit(HearJournal(module, tuple(found)), str(module))
        except BusError as error:
            self._looked_for.pop(module, None)  # compared again with the next heartbeat
            _log.info("journal_not_read", module=module, why=str(error))
        except LabosError as error:
            _log.warning("discovery_not_written", module=module, why=str(error))

    def _is_known(self, module: ModuleName, name: ActionId) -> bool:
        actions = self._kernel.state.actions
        if name in actions.open or name in actions.settled or name in actions.discovered:
            return True
        return name in actions.ended.get(module, ()) or name in self._in_log.get(module, ())
