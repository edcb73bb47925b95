"""A device that waits for somebody in the midst of an action: paused by hand, its door open, no tips left.

Its node says so as an error of the module, and the action goes on when somebody has seen to it. A person is
asked once that has lasted ``WAITS_S``; nothing is done by the answer.
"""

from __future__ import annotations

from labos.core.actions import Action
from labos.core.ids import ModuleName, local
from labos.core.interventions import UNNUMBERED, Choice, InterventionRequested, InterventionResolved
from labos.core.modules import DEVICE_WAITS
from labos.core.registry import Event
from labos.core.state import LabState


def asked_to_see_to(state: LabState, action: Action) -> InterventionRequested:
    """The question about the module that stands still with this action."""
    name = local(action.module)
    said = state.modules.by_name[action.module].error.rstrip(".") or "it does not say why"
    return InterventionRequested(
        UNNUMBERED,
        DEVICE_WAITS,
        action.module,
        f"{name} stands still in the midst of {action.name!r} of {action.run}: {said}. "
        "The step goes on by itself when that is put right.",
        (Choice("noted", "Somebody sees to it; this is not asked again while it lasts."),),
        run=action.run,
        module=action.module,
    )


def waits_no_more(state: LabState, name: ModuleName, why: str) -> list[Event]:
    """The question about a module answers itself."""
    questions = map(state.interventions.open.__getitem__, state.interventions.by_subject.get(name, ()))
    return [
        InterventionResolved(question.id, "withdrawn", "labos", why)
        for question in questions
        if question.kind == DEVICE_WAITS
    ]
