"""A device that waits for a person during an action: it was paused by hand, its door is open, or it has no
tips left.

Its node reports this as an error of the module. The action continues when a person has dealt with it. A
person is asked when it has lasted ``WAITS_S``; the answer itself has no effect.
"""

from __future__ import annotations

from collections.abc import Iterator

from labos.core.actions import (
    Action,
    ActionEvent,
    ActionFailed,
    ActionRejected,
    ActionReported,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.ids import local
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.modules import NodeLeft, NodeStateChanged
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.topics import DeviceWaits, PlannedWork, UnknownAction


def ask_about_waiting_device(state: LabState, action: Action) -> InterventionRequested:
    """The question about the module that stands still during this action."""
    name = local(action.module)
    error = state.modules.by_name[action.module].error.rstrip(".") or "without a reason"
    return state.interventions.ask(
        DeviceWaits(run=action.run, module=action.module),
        f"{name} has stopped during {action.name!r} of {action.run}: {error}. The step continues by "
        "itself when this is corrected.",
    )


# -- reactions -----------------------------------------------------------------------------------


def withdraw_waiting(state: LabState, event: ActionEvent | NodeLeft | NodeStateChanged) -> Iterator[Event]:
    """The question about a waiting device is withdrawn when the device continues, or can no longer
    continue."""
    if isinstance(event, NodeStateChanged) and event.status == "ERROR":
        return
    for question in state.interventions.list_about(event.module, DeviceWaits):
        yield question.withdraw(_GOES_ON.get(type(event), "its action has ended"))


_GOES_ON: dict[type[Event], str] = {
    ActionUnknown: "the outcome of its action is not known",
    NodeLeft: "its node is gone",
    NodeStateChanged: "it goes on",
}


def withdraw_action_questions(state: LabState, event: ActionEvent) -> Iterator[Event]:
    """The questions about an action are withdrawn when its node reports the outcome; a question about planned
    work is answered with the outcome, which a simulated person reports through the node."""
    for question in state.interventions.list_about(event.action):
        if isinstance(question.topic, PlannedWork) and isinstance(event, ActionSucceeded | ActionFailed):
            done = "done" if isinstance(event, ActionSucceeded) else "not_done"
            yield InterventionResolved(question.id, done, question.module)
        elif isinstance(question.topic, UnknownAction) or isinstance(event, ActionRejected | ActionReported):
            yield question.withdraw("the node has answered")
