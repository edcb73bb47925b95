"""How the operator answers what the lab asks: as somebody who looks at plates before she says a word."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from labos.core.actions import Action
from labos.core.ids import ActionId, local, workcell_of
from labos.core.interventions import Intervention
from labos.core.state import LabState
from labos.core.topics import FailedStep, LostExperiment, UnknownAction
from labos.node.world import World
from labos.testing.person import look

WORKED_BY = {"run_protocol": "pipette", "run_program": "synthesise"}
"""What the bench calls it that an action has been done to a plate; of a cycler, it is ``cycle``."""

MEASURES = ("take_picture", "read_plate", "measure_sample", "expose")
"""What only looks is done again: nobody has its result."""


def answer(
    world_of: Callable[[str], AbstractContextManager[World]], state: LabState, question: Intervention
) -> str:
    """What she says; empty for what she leaves alone: a silent program will be started again."""
    if isinstance(question.topic, LostExperiment):
        return ""
    cell = workcell_of(question.module) if question.module else "rpl"
    with world_of(cell) as world:
        if isinstance(question.topic, UnknownAction):
            action = state.actions.open.get(ActionId(question.subject))
            if action is not None and action.name in MEASURES:
                return "not_done"
            if action is not None and action.name in WORKED_BY:
                return "done" if _was_done(world, state, action) else "not_done"
        if isinstance(question.topic, FailedStep):
            names = [choice.name for choice in question.choices]
            return "retry" if "retry" in names else names[0]
        return look(world, state, question)


def _was_done(world: World, state: LabState, action: Action) -> bool:
    """Whether the plate that stands there shows it."""
    nests = [local(name) for name in state.bench.by_module.get(action.module, ())]
    device = local(action.module)
    verbs = ("cycle",) if device.startswith("biometra") else (WORKED_BY[action.name],)
    plates = [plate for nest in nests for plate in world.at(nest)]
    seen: list[Any] = [m for plate in plates for m in world.history(plate, *verbs) if m.device == device]
    wells = action.args.get("destination_wells") or action.args.get("wells")
    if wells:
        return any(set(wells) <= set(motion.facts.get("wells") or ()) for motion in seen)
    return bool(seen)
