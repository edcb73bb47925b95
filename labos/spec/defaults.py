"""Defaults for steps from their module's entry in the workcell file: retries and time-outs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.core.ids import ModuleName
from labos.core.model import ActionSpec, ModuleSpec, RetryDefault, Workcell
from labos.core.setups import Setup, SetupChange
from labos.errors import SpecError
from labos.spec.findings import Remarks
from labos.spec.models import NONE, ModuleEntry, RetryEntry, StepEntry
from labos.spec.references import fill
from labos.spec.source import Path_


def retry_of(entry: ModuleEntry) -> RetryDefault | None:
    """The retries in a module's entry."""
    written = entry.retry
    return None if written is None else RetryDefault(written.times, written.delay, written.reset)


def make_setup(entry: ModuleEntry) -> Setup | None:
    """The set-up times in a module's entry."""
    written = entry.setup
    if written is None:
        return None
    changes = tuple(SetupChange(change.from_, change.to, change.takes) for change in written.changes)
    return Setup(written.by, written.takes, changes)


def find_timeout(entry: StepEntry, action: ActionSpec, remarks: Remarks, path: Path_) -> float | None:
    """The time-out of a step in lab seconds. Afterwards its outcome counts as unknown. A time-out that is
    shorter than the action's nominal duration gives a warning."""
    if not isinstance(entry.timeout, float):
        return None
    if entry.timeout < action.duration_s and not action.by_person:
        remarks.add_warning(
            f"Step {entry.name!r} counts as unknown after {entry.timeout:g} s, and {entry.action} takes "
            f"{action.duration_s:g} s.",
            (*path, "timeout"),
            "Give the step a longer `timeout`, or `none`; without one, the module's timeout applies.",
        )
    return entry.timeout


class Defaults:
    """The defaults of a workcell's modules for steps."""

    def __init__(self, workcell: Workcell) -> None:
        self._prefix = f"{workcell.name}/"
        self._modules = {module.name: module for module in workcell.modules}

    def fill_in(self, entry: StepEntry, scope: Mapping[str, Any]) -> StepEntry:
        """A step with the defaults of its module for missing fields; ``none`` means no default."""
        module = self._find_module(entry, scope)
        retry, timeout = entry.retry, entry.timeout
        if retry is None and module is not None and module.retry is not None:
            default = module.retry
            reset = default.reset and entry.action != "reset"
            retry = RetryEntry(times=default.times, delay=default.delay_s, reset=reset)
        if timeout is None and module is not None:
            timeout = module.timeout_s
        kept = {"retry": None if retry == NONE else retry, "timeout": None if timeout == NONE else timeout}
        changed = {key: value for key, value in kept.items() if value != getattr(entry, key)}
        return entry.model_copy(update=changed) if changed else entry

    def _find_module(self, entry: StepEntry, scope: Mapping[str, Any]) -> ModuleSpec | None:
        """The module of a step, which may come from the payload; None if this is reported as a fault
        later."""
        try:
            name = fill(entry.module, scope)
        except SpecError:
            return None
        if not isinstance(name, str):
            return None
        return self._modules.get(ModuleName(f"{self._prefix}{name.removeprefix(self._prefix)}"))
