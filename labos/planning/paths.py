"""The motions of a plan. Deadlock avoidance (``safety``) sees a plan only as motions.

A step that carries nothing ends and gives back what it used, so it blocks no other run permanently.
Exceptions are steps after which the run holds something, for example an open door or lid, and steps that set
a variable of a module.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple

import msgspec

from labos.core.algebra import ModuleSettings, compute_settings_after, find_requirements, list_away_from_rest
from labos.core.branches import Way, list_ways
from labos.core.decide.together import find_planned_wish
from labos.core.effects import (
    NOWHERE,
    Carrying,
    Lid,
    Needs,
    changes_labware,
    list_arrivals,
    list_carried,
    name_hand,
)
from labos.core.ids import ModuleName, Owner, StationName
from labos.core.model import Plan, PlanStep, Together
from labos.planning.held import door_key, hold_key, ready_key, setpoint_key, variable_key

END: Final = "end"
"""In place of a step's index: the end of a run, which frees all that the run holds."""

FORKED: Final = "forked"
"""In place of a step's index in a witness: all motions behind an actor's first fork."""


MOST_ORDERS = 500
"""The most orders of one plan whose motions are kept."""


class ClosingStep(NamedTuple):
    """A step of the closing workflow that follows a run, or the end of that workflow."""

    step: MotionStep


MotionStep = int | Literal["end", "forked"] | ClosingStep
"""What a motion belongs to: a step of the run's plan (its index), the run's end, a fork, or the closing
workflow that follows the run."""

Values = Mapping[str, Any]


def name_leftover_owner(experiment: Owner) -> Owner:
    """The owner, on a floor, of the labware that the runs of an experiment leave when they end. The closing
    workflow clears it away, and no other run relies on it."""
    return Owner(f"left by {experiment}")


Settings = tuple[tuple[str, Any], ...]
"""Keys of variables of modules, with their values."""


class Motion(msgspec.Struct, frozen=True):
    """One change of the bench. Labware moves from ``source`` (a stack, if ``new``) to ``target``. Without a
    ``target`` it moves nothing. ``grabs`` is what the run holds from then on (key and value; value None: not
    shared with any run), ``frees`` what it no longer holds. No other run may hold the module that it
    ``uses``.

    ``needs``: for each need, labware that the run has not brought has to stand at one of the places. It is
    lent to the run; with ``keeps`` it is the run's for good. ``returns``: labware that is lent to the run
    goes back. ``wants`` are the values that variables of modules must have, ``sets`` those that they have
    afterwards. Doors and lids have a rest position; they are held instead. A motion that ``recovers`` a
    module may start whatever other runs hold. ``back``: the outcome of a step in flight is known. With a
    ``target`` it failed: its labware is there (on its stack again, if ``new``) and not at ``source``. Without
    one, ``source`` is no longer kept free for it. ``heir``: the owner that gets the run's labware.

    ``joint`` is the module that carries the step out at once for all runs with labware in it. All of them
    have to be ready for the same ``wish``. ``for_step`` is the later joint step for which this one makes the
    run ready; ``is_last``: of all steps before the joint one, this is the last in this order.

    The other fields are those of the effect (see ``effects.Carrying``). All needs of a step are checked
    before its first motion, so that motion has them all. A place where labware or room is needed twice is
    listed twice. ``hand`` has to be empty."""

    step: MotionStep
    source: StationName = NOWHERE
    target: StationName = NOWHERE
    via: StationName = NOWHERE
    new: bool = False
    uses: ModuleName = ModuleName("")
    grabs: tuple[tuple[str, Any], ...] = ()
    frees: tuple[str, ...] = ()
    needs: tuple[tuple[StationName, ...], ...] = ()
    keeps: bool = False
    returns: bool = False
    heir: Owner = Owner("")
    joint: ModuleName = ModuleName("")
    wish: bytes | None = None
    for_step: int | None = None
    is_last: bool = False
    wants: Settings = ()
    sets: Settings = ()
    recovers: bool = False
    lid: Lid = ""
    back: bool = False
    stock: StationName = NOWHERE
    emptied: StationName = NOWHERE
    filled: StationName = NOWHERE
    plate_at: StationName = NOWHERE
    stands: tuple[StationName, ...] = ()
    entered: tuple[StationName, ...] = ()
    room: tuple[StationName, ...] = ()
    hand: StationName = NOWHERE

    @property
    def changes_anything(self) -> bool:
        """Whether it changes where labware stands or whose it is, what the run holds, or a module's
        variable."""
        gives = self.frees or self.returns or self.heir
        return bool(self.target or self.grabs or gives or self.needs or self.sets)


def carry(
    step: int,
    *effects: Carrying,
    uses: ModuleName,
    hand: StationName,
    guarded: Collection[StationName],
    room: Sequence[StationName],
    wants: Settings = (),
) -> list[Motion]:
    """The motions of a step that carries something, by a module with this ``hand``. An arm can be prevented
    from reaching in only at ``guarded`` places; hands are among them. The whole step needs ``room``."""
    motions: list[Motion] = []
    for what in effects:
        motion = Motion(
            step,
            what.source,
            what.target,
            what.via,
            new=bool(what.stock),
            uses=uses,
            lid=what.lid,
            stock=what.stock,
            emptied=what.emptied,
            filled=what.filled,
            plate_at=what.plate_at,
        )
        if not motions:
            motion = msgspec.structs.replace(
                motion,
                stands=_list_needed_places(effects),
                entered=tuple(dict.fromkeys(p for each in effects for p in each.entered if p in guarded)),
                room=tuple(room),
                wants=wants,
                hand=hand if hand in guarded and any(e.source != hand for e in effects) else NOWHERE,
            )
        motions.append(motion)
    return motions


def _list_needed_places(effects: Sequence[Carrying]) -> tuple[StationName, ...]:
    """The places where labware has to stand before a step, once for each piece. Labware that one effect
    carries away is no longer there for the next effects. A plate whose lid is carried stays."""
    needed: Counter[StationName] = Counter()
    away: Counter[StationName] = Counter()
    for what in effects:
        for place in what.stands:
            needed[place] = max(needed[place], away[place] + 1)
        if what.stands:
            away[what.emptied] += 1
    return tuple(needed.elements())


class CellRules(msgspec.Struct, frozen=True):
    """What the motions of steps depend on in a workcell. ``claims``: the claims of its stations (empty: no
    claim, but a hand or a station behind a door). ``rests``: the rest positions of its modules' doors and
    lids. ``nests``: the stations at which modules work on labware, as plans name them. ``joint``: what
    modules do for several runs at once."""

    claims: Mapping[StationName, str] = {}
    rests: Mapping[ModuleName, Values] = {}
    nests: Mapping[ModuleName, tuple[StationName, ...]] = {}
    joint: Mapping[ModuleName, Together] = {}


NO_RULES = CellRules()


class Orders(msgspec.Struct, frozen=True):
    """A plan whose steps have several possible orders, and what the motions of each order depend on.
    ``steps`` are those of its only way, in the order of the plan. ``behind`` has, for each step, the steps
    that have to be done before it. ``known`` has the motions of orders that were listed before."""

    plan: Plan
    steps: tuple[int, ...]
    behind: Mapping[int, frozenset[int]]
    rules: CellRules
    known: dict[tuple[int, ...], tuple[Motion, ...]] = {}

    def list_motions(self, order: tuple[int, ...]) -> tuple[Motion, ...]:
        """The motions of these steps in this order, and of the run's end."""
        found = self.known.get(order)
        if found is None:
            if len(self.known) >= MOST_ORDERS:
                self.known.clear()
            found = self.known[order] = list_motions_of_steps(self.plan, order, self.rules)
        return found


class Path(msgspec.Struct, frozen=True):
    """The ``motions`` of a plan if nothing fails, in an order that its ``after`` relations allow.
    ``changing`` are the steps whose motions change something. ``ways``: the motions of each way, if the plan
    has several ways. ``orders``: set if the plan has one way, but several orders of its steps."""

    motions: tuple[Motion, ...]
    changing: frozenset[MotionStep] = frozenset()
    ways: tuple[tuple[Way, tuple[Motion, ...]], ...] = ()
    orders: Orders | None = None


def make_path(plan: Plan, rules: CellRules = NO_RULES) -> Path:
    """The path of a plan; steps are in an order in which they may run one after the other."""
    ways = [(way, list_motions_of_steps(plan, way.steps, rules)) for way in list_ways(plan)]
    (first, motions), *others = ways
    changing = frozenset(motion.step for motion in motions if motion.changes_anything)
    if others:
        return Path(motions, changing, tuple(ways))
    if all(before in plan.steps[index].after for before, index in pairwise(first.steps)):
        return Path(motions, changing)  # most plans: each step names the one before it
    behind = _find_behind(plan, first.steps)
    if all(before in behind[index] for before, index in pairwise(first.steps)):
        return Path(motions, changing)
    return Path(motions, changing, orders=Orders(plan, first.steps, behind, rules))


def _find_behind(plan: Plan, order: Sequence[int]) -> dict[int, frozenset[int]]:
    """For each of these steps, all of them that have to be done before it."""
    found: dict[int, frozenset[int]] = {}
    for index in order:
        after = [before for before in plan.steps[index].after if before in found]
        found[index] = frozenset(after).union(*(found[before] for before in after))
    return found


class RunOnBench(msgspec.Struct):
    """What a run has on the bench before its next motion. ``own`` counts its labware by place, ``claims``
    by claim. ``lent`` has the places where labware is lent to it. ``doors`` has the positions in which it has
    left doors and lids. ``held`` is what it holds by doors, setpoints and holds."""

    own: Counter[StationName] = msgspec.field(default_factory=Counter)
    lent: dict[StationName, bool] = {}
    claims: Counter[str] = msgspec.field(default_factory=Counter)
    doors: dict[ModuleName, dict[str, Any]] = {}
    held: dict[str, bool] = {}

    def carry(self, what: Carrying, claims: Mapping[StationName, str]) -> None:
        """Carry labware. A plate whose lid is carried belongs to the run too."""
        self.claims[claims.get(what.emptied, "")] -= 1
        self.claims[claims.get(what.filled, "")] += 1
        if self.own[what.emptied]:
            self.own[what.emptied] -= 1
        for place in (what.filled, what.plate_at):
            self.own[place] = max(self.own[place], 1) if place == what.plate_at else self.own[place] + 1
            self.lent.pop(place, None)
        self.lent.pop(what.emptied, None)

    def lend(
        self, places: tuple[StationName, ...], claims: Mapping[StationName, str], *, keeps: bool
    ) -> None:
        """Lend labware at one of these places to the run; if it ``keeps`` it, for good. It counts as the
        run's only if there is just one place."""
        if not keeps:
            self.lent.update(dict.fromkeys(places, True))
        if len(places) == 1:
            if keeps:
                self.lent.pop(places[0], None)
            if not self.own[places[0]]:
                self.own[places[0]] = 1
                self.claims[claims.get(places[0], "")] += 1


def list_motions_of_steps(
    plan: Plan, order: Sequence[int], rules: CellRules, before: RunOnBench | None = None
) -> tuple[Motion, ...]:
    """The motions of steps that are carried out in this order. Changes ``before``, what the run has."""
    motions: list[Motion] = []
    before = RunOnBench() if before is None else before
    standing, values, held = before.claims, before.doors, before.held
    ever, lent = dict(held), bool(before.lent)
    behind = _find_joint_behind(plan, order, rules.joint)
    for index in order:
        step = plan.steps[index]
        rest, after = rules.rests.get(step.module, {}), compute_settings_after(step.effects)
        doors = values.setdefault(step.module, {})
        doors.update(after.variables)
        grabs, frees = _find_holds(plan, index, after, away=bool(list_away_from_rest(doors, rest)), held=held)
        held.update(dict.fromkeys((key for key, _ in grabs), True))
        ever.update(held)
        moving = list_carried(step.effects)
        mine = standing[step.module] or (door_key(step.module) in held and not grabs)
        # A run that holds a module in error needs the recovery, so the recovery does not wait for it.
        user = ModuleName("") if step.recovers else step.module
        uses = user if step.exclusive and not moving else ModuleName("")
        needs, keeps = _list_needs(step, rules.nests, before), changes_labware(step.effects)
        lent = lent or bool(needs)
        wants = _drop_resting_values(step.module, find_requirements(step.effects), rest)
        sets = _drop_resting_values(step.module, after.variables, rest)
        room = tuple(list_arrivals(step.effects))
        if grabs or needs or ((wants or room) and not moving) or (uses and not mine):
            motions.append(
                Motion(
                    index,
                    uses=uses,
                    grabs=grabs,
                    needs=needs,
                    keeps=keeps and bool(needs),
                    wants=() if moving else wants,
                    room=() if moving else room,
                    recovers=step.recovers,
                )
            )
        for places in needs:
            before.lend(places, rules.claims, keeps=keeps)
        hand = name_hand(step.module)
        motions += carry(index, *moving, uses=user, hand=hand, guarded=rules.claims, room=room, wants=wants)
        for what in moving:
            before.carry(what, rules.claims)
        if is_joint(rules.joint, step):
            wish = find_planned_wish(plan, step)
            motions.append(Motion(index, frees=(ready_key(step.module),), joint=step.module, wish=wish))
        if frees or sets:
            motions.append(Motion(index, frees=frees, sets=sets))
            for key in frees:
                held.pop(key, None)
        motions += [_make_ready(plan, index, later, is_last=last) for later, last in behind.get(index, ())]
    ever.update((ready_key(plan.steps[later].module), True) for each in behind.values() for later, _ in each)
    if ever or lent:  # also frees what it freed before: parallel steps may end in any order
        motions.append(Motion(END, frees=tuple(ever), returns=lent))
    return tuple(motions)


def _find_joint_behind(
    plan: Plan, order: Sequence[int], joint: Mapping[ModuleName, Together]
) -> dict[int, list[tuple[int, bool]]]:
    """For each step, the joint steps (for several runs at once) that come directly after it. True if no other
    step directly before the joint step comes later in this order."""
    found: dict[int, list[tuple[int, bool]]] = {}
    place = {step: position for position, step in enumerate(order)} if joint else {}
    for index in place:
        if is_joint(joint, plan.steps[index]):
            before = sorted(
                (step for step in plan.steps[index].after if step in place), key=place.__getitem__
            )
            for step in before:
                found.setdefault(step, []).append((index, step == before[-1]))
    return found


def _make_ready(plan: Plan, index: int, later: int, *, is_last: bool) -> Motion:
    """The motion by which a step makes a run ready for a later one, if all others before that are done."""
    step = plan.steps[later]
    grabs = ((ready_key(step.module), find_planned_wish(plan, step)),)
    return Motion(index, grabs=grabs, for_step=later, is_last=is_last)


def _list_needs(
    step: PlanStep, nests: Mapping[ModuleName, tuple[StationName, ...]], before: RunOnBench
) -> tuple[tuple[StationName, ...], ...]:
    """The places where a step needs labware that its run has not brought there, or changes labware that is
    lent to the run; one group of places for each need."""
    found: list[tuple[StationName, ...]] = []
    for effect in step.effects:
        if isinstance(effect, Needs):
            places = (effect.station,) if effect.station else nests.get(step.module, ())
            brought = any(before.own[place] > 0 for place in places)
            changed = changes_labware(step.effects) and any(place in before.lent for place in places)
            if places and (changed or not brought):
                found.append(places)
    return tuple(found)


def is_joint(joint: Mapping[ModuleName, Together], step: PlanStep) -> bool:
    """Whether a module carries a step out for several runs at once."""
    return step.module in joint and step.action in joint[step.module].actions


def _find_holds(
    plan: Plan, index: int, after: ModuleSettings, *, away: bool, held: Mapping[str, bool]
) -> tuple[Settings, tuple[str, ...]]:
    """What a run begins to hold with a step (keys and values), and what it frees with it (keys)."""
    step = plan.steps[index]
    door = door_key(step.module)
    grabs: list[tuple[str, Any]] = []
    frees: list[str] = []
    if step.exclusive and away and door not in held:
        grabs.append((door, None))
    elif step.exclusive and not away and door in held:
        frees.append(door)
    grabs += [(setpoint_key(step.module, name), value) for name, value in after.claims.items()]
    frees += [setpoint_key(step.module, name) for name in after.releases]
    for hold in plan.holds:
        if hold.first == index:
            grabs.append((hold_key(hold.module), None))
        if hold.last == index:
            frees.append(hold_key(hold.module))
    return tuple(grabs), tuple(frees)


def _drop_resting_values(module: ModuleName, values: Values, rest: Values) -> Settings:
    """The values of a module's variables by key, without its doors and lids."""
    return tuple((variable_key(module, name), value) for name, value in values.items() if name not in rest)
