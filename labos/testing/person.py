"""A person in a simulated lab, who looks at the bench and answers like a real person."""

from __future__ import annotations

from labos.core.actions import Action
from labos.core.effects import Claims, Move, Relid, Take, Unlid
from labos.core.holding import find_other_claimant, find_user_meanwhile
from labos.core.ids import ActionId, RunId, local
from labos.core.interventions import Intervention
from labos.core.state import LabState
from labos.core.topics import FailedStep, LateStep, LeftLabware, LostLabware, PlannedWork, UnknownAction
from labos.node.world import FLOOR, World, lid_of
from labos.services.truth import bench_name

UNDONE_BY = (("pick_pipette", "place_pipette"), ("create_sample", "dispose_tip"))
"""Pairs of actions that undo each other. The bench shows which of them was the last."""


def look(world: World, state: LabState, question: Intervention) -> str:
    """Look at the bench, remove obstacles, and choose an answer."""
    if isinstance(question.topic, UnknownAction):
        action = state.actions.open[ActionId(question.subject)]
        for effect in action.effects:
            if isinstance(effect, Move):
                return _look_for_move(world, state, question, local(action.module), effect)
            if isinstance(effect, Take):
                return _look_for_take(world, state, local(action.module), effect)
        return _look_at_device(world, state, action)
    if isinstance(question.topic, LostLabware):
        return _look_for_lost(world, state, question)
    if isinstance(question.topic, LeftLabware):
        for name in question.labware:
            labware = state.bench.labware.get(name)
            if labware is not None and labware.station:
                station = state.bench.stations[labware.station]
                for plate in world.at(bench_name(station.spec))[-1:]:
                    world.carry(plate, "")
        return "removed"
    if isinstance(question.topic, PlannedWork):
        return _do_work(world, state, question)
    if isinstance(question.topic, LateStep):
        return question.choices[int(question.run[1:]) % len(question.choices)].name
    if isinstance(question.topic, FailedStep):
        return question.choices[(int(question.id[1:]) + int(question.run[1:])) % len(question.choices)].name
    return question.choices[0].name


def _do_work(world: World, state: LabState, question: Intervention) -> str:
    """Do the planned work of a workflow, unless it was done before; the earlier report may have been lost."""
    for effect in state.actions.open[ActionId(question.subject)].effects:
        if isinstance(effect, Move):
            station = state.bench.stations[effect.source]
            here = world.at(local(effect.source))
            if len(here) >= len(station.labware) + len(station.stock):
                world.grip(local(question.module), local(effect.source))
                _put_down(world, state, local(question.module), effect)
    return "done"


def _put_down(world: World, state: LabState, device: str, effect: Move) -> None:
    waste = state.bench.stations[effect.target].spec.kind == "waste"
    (world.discard if waste else world.release)(device, local(effect.target))


def _look_for_lost(world: World, state: LabState, question: Intervention) -> str:
    found = "done"
    for effect in question.motions:
        if isinstance(effect, Move):
            found = _look_for_move(world, state, question, local(question.module), effect)
        elif isinstance(effect, Take):
            found = _look_for_take(world, state, local(question.module), effect)
    return {"done": "target", "not_done": "source", "gone": "gone"}[found]


def _pick_up(world: World, device: str) -> bool:
    """Remove the first piece that a device has dropped; there is a question about each piece. Returns whether
    there was one."""
    fallen = [m.plate for m in world.motions("drop") if m.device == device]
    here = [plate for plate in world.at(FLOOR) if plate in fallen]
    for plate in here[:1]:
        world.carry(plate, "")
    return bool(here)


def _look_for_move(world: World, state: LabState, question: Intervention, device: str, effect: Move) -> str:
    if isinstance(effect, Unlid | Relid):
        return _look_for_lid(world, device, effect)
    if _pick_up(world, device):
        return "gone"
    hand, source = f"hand:{device}", state.bench.stations[effect.source]
    if source.spec.kind == "gripper":
        return "not_done" if world.at(hand) else "done"
    for place in (hand, local(effect.via)):
        if place:
            for plate in world.at(place):
                if _is_used_meanwhile(state, question, effect):  # it was seen in the hand
                    waste = state.bench.stations[effect.target].spec.kind == "waste"
                    world.carry(plate, "" if waste else local(effect.target))
                    return "done"
                world.carry(plate, _slot(state, effect) or local(effect.source))
                return "not_done"
    slot = _slot(state, effect)
    if slot:
        return "not_done" if world.at(slot) else "done"
    here = len(world.at(local(effect.source)))
    others = len(source.labware) + len(source.stock) - (effect.labware in source.labware)
    return "not_done" if here > others else "done"


def _is_used_meanwhile(state: LabState, question: Intervention, effect: Move) -> bool:
    run = state.runs.active.get(RunId(question.run))
    if run is not None:
        return bool(find_user_meanwhile(state, effect.source, run))
    source, owner = state.bench.stations[effect.source], state.bench.labware[effect.labware].owner
    return source.full or bool(source.spec.claim and find_other_claimant(state, source.spec.module, (owner,)))


def _slot(state: LabState, effect: Move) -> str:
    """The slot in which labware was stored, if its device chose and reported the slot."""
    labware, module = state.bench.labware.get(effect.labware), state.bench.stations[effect.source].spec.module
    slot = labware.variables.get("slot") if labware is not None else ""
    return f"{local(module)}.{slot}" if slot and local(effect.source) == f"{local(module)}.slots" else ""


def _look_for_lid(world: World, device: str, effect: Unlid | Relid) -> str:
    off = isinstance(effect, Unlid)
    bears = world.at(local(effect.source if off else effect.target))[-1]
    source = lid_of(bears) if off else local(effect.source)
    for place in (f"hand:{device}", local(effect.via)):
        for lid in world.at(place) if place else ():
            world.carry(lid, source)
            return "not_done"
    return "not_done" if bool(world.at(lid_of(bears))) == off else "done"


def _look_for_take(world: World, state: LabState, device: str, effect: Take) -> str:
    if _pick_up(world, device):
        return "gone"
    for plate in world.at(f"hand:{device}"):
        if world.is_full(local(effect.target)):  # by labware that another answer has just put back
            world.carry(plate, "")
            return "gone"
        world.carry(plate, local(effect.target))
        return "done"
    stack = state.bench.stations[effect.stack]
    return "not_done" if len(world.at(local(effect.stack))) == len(stack.stock) else "done"


def _look_at_device(world: World, state: LabState, action: Action) -> str:
    nests = [local(name) for name in state.bench.by_module.get(action.module, ())]
    plates = [plate for nest in nests for plate in world.at(nest)]
    if action.name in ("seal", "peel") and plates:
        return "done" if world.last(plates[-1], "seal", "peel") == action.name else "not_done"
    if action.name == "spin" and plates:
        return "done" if all(world.history(plate, action.name) for plate in plates) else "not_done"
    if undone := [pair for pair in UNDONE_BY if action.name in pair]:
        did = [m.verb for m in world.motions() if m.device == local(action.module) and m.verb in undone[0]]
        return "done" if did[-1:] == [action.name] else "not_done"
    noted = [m.facts for m in world.motions(action.name) if m.device == local(action.module)]
    if not noted and any(isinstance(effect, Claims) for effect in action.effects):
        return "not_done"  # it has never been set
    if noted and any(noted[-1].get(name, value) != value for name, value in action.args.items()):
        return "not_done"  # the device shows the previous setting
    if action.name in ("open_lid", "close_lid"):
        return "done" if any(map(world.is_shut, nests)) == (action.name == "close_lid") else "not_done"
    return "done"
