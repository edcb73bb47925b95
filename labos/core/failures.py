"""The failures of each module since it was last put into service.

A failure is a failed action, an action with an unknown outcome, or a lost node. An action that the workflow
retries counts only after its last retry. These are no failures: a node that ended with its kernel, a node
that LabOS ended, and a person who cannot do planned work.
"""

from __future__ import annotations

from labos.core.actions import ActionFailed, ActionUnknown
from labos.core.ids import ModuleName
from labos.core.interventions import InterventionRequested
from labos.core.lab import KernelStarted
from labos.core.modules import Failure, Module, ModulePutBack, Modules, NodeJoined, NodeLeft
from labos.core.steps import StepRetried
from labos.core.topics import DeviceWaits, PlannedWork

FAILURES_KEPT = 50

LONGEST = 200
"""The most characters that are kept of a failure's description."""

SUSPICIOUS = (ActionFailed, ActionUnknown, NodeLeft)
"""Events after which the number of a module's failures is checked."""


def list_failures_since(module: Module, at: int) -> list[Failure]:
    """A module's failures since a time (UTC ns), oldest first."""
    return [failure for failure in module.failures if failure.at >= at]


def fold_kernel_started(modules: Modules, event: KernelStarted, at: int) -> None:
    for module in modules.by_name.values():
        module.joined = False


def fold_node_joined(modules: Modules, event: NodeJoined, at: int) -> None:
    modules.by_name[event.module].joined = True


def fold_node_left(modules: Modules, event: NodeLeft, at: int) -> None:
    module = modules.by_name[event.module]
    if module.joined and not event.stopped:
        _note_failure(module, Failure(at, f"its node was lost: {event.why}", tuple(module.in_flight)))
    module.joined = False


def fold_action_failed(modules: Modules, event: ActionFailed | ActionUnknown, at: int) -> None:
    what = event.error if isinstance(event, ActionFailed) else event.why
    _note_failure(modules.by_name[event.module], Failure(at, what, (event.action,), event.run, event.step))


def fold_step_retried(modules: Modules, event: StepRetried, at: int) -> None:
    for module in modules.by_name.values():
        last = module.failures[-1] if module.failures else None
        if last is not None and (last.run, last.step) == (event.run, event.step):
            module.failures.pop()


def fold_module_put_back(modules: Modules, event: ModulePutBack, at: int) -> None:
    modules.by_name[event.module].failures.clear()


def fold_intervention_requested(modules: Modules, event: InterventionRequested, at: int) -> None:
    module = modules.by_name.get(ModuleName(event.module))
    if module is not None and isinstance(event.topic, PlannedWork):
        module.person = True
    elif module is not None and isinstance(event.topic, DeviceWaits):
        module.asked = True


def _note_failure(module: Module, failure: Failure) -> None:
    """Add a failure, unless it is the outcome of an action that was lost with its node."""
    noted = {action for known in module.failures for action in known.actions}
    if module.person or noted.intersection(failure.actions):
        return
    failure.what = failure.what[:LONGEST]
    module.failures.append(failure)
    del module.failures[:-FAILURES_KEPT]
