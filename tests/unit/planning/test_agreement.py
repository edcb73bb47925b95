"""Rules, safety's floor, rehearsals and dry runs say the same of one step on one bench: whether it may
happen, and where everything stands afterwards.

What one of them cannot know is left out of the comparison, and only that: the floor and a scene know nothing
of what labware is like, nor of what nobody is sure of; a dry run knows nothing of others.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec
import pytest

from labos.core.bench import Bench
from labos.core.decide import LABOS, Rejection, carry_out
from labos.core.decide.actions import FinishAction, StartStep
from labos.core.effects import Carrying, Needs, list_arrivals
from labos.core.fold import evolve
from labos.core.ids import SHARED, ActionId, RunId
from labos.core.model import PlanStep
from labos.core.registry import Event
from labos.core.rules import examine
from labos.core.runs import RunState, StepState
from labos.core.waits import Wait
from labos.planning.floor import Actor, Floor
from labos.planning.layout import lay_out
from labos.planning.moves import may_move, move
from labos.planning.player import Player
from labos.planning.safety import Safety
from labos.planning.scene import Scene
from labos.spec.dryrun import DryRun
from labos.spec.paper import Piece
from labos.spec.stations import Stations
from tests.support.bench import CELL
from tests.support.random_benches import MINE, USERS, RandomBench, benches

FEW, MANY = 2_000, 100_000

OF_PLACES = {
    "buried",
    "hand_full",
    "held",
    "not_yours",
    "nothing_there",
    "occupied",
    "stack_empty",
    "waste_full",
}
"""Waits for what floor and scene know as well: who stands where, how full it is, and who keeps a module."""

OF_LABWARE = {
    "buried",
    "hand_full",
    "no_access",
    "no_grip",
    "not_accepted",
    "occupied",
    "requires",
    "wrong_way",
}
"""Waits for what a dry run knows as well, where nobody else is on the bench."""


class Trial:
    """One step on one bench, as each of those sees it who judge it."""

    def __init__(self, bench: RandomBench) -> None:
        self.bench, self.state = bench, bench.state
        self.run: RunState = bench.state.runs.active[RunId("R1")]
        self.step: PlanStep = bench.step()
        known = self.state.runs.plans[self.run.plan]
        known.plan = msgspec.structs.replace(known.plan, steps=(self.step, known.plan.steps[1]))
        self.run.steps = [StepState(), StepState()]
        found = examine(self.state, self.run, 0, 0)
        self.code = found.code if isinstance(found, Wait) else ""
        self.safety = Safety()

    @property
    def is_clear(self) -> bool:
        """Whether it is known of every station what stands there."""
        known = all(s.known for s in self.state.bench.stations.values() if s.spec.kind != "waste")
        return known and not self.state.bench.uncertain_at

    @property
    def meets_stock(self) -> bool:
        """Whether something goes to a stack or the waste: a dry run does not know how much is there."""
        met = [self.state.bench.stations[place] for place in list_arrivals(self.step.effects)]
        return any(station.stock or station.spec.kind == "waste" for station in met)

    def floor(self) -> tuple[Floor, Actor]:
        actors = self.safety.list_actors(self.state, CELL)
        floor = lay_out(self.state, CELL, actors, hopeful=False)
        return floor, next(actor for actor in actors if actor.name == self.run.id)

    def move(self) -> tuple[Floor, Actor] | None:
        """The floor after the step; None if it is not possible there."""
        floor, mover = self.floor()
        for motion in self.safety._list_motions(self.state, self.run, 0):
            if not may_move(floor, mover, motion):
                return None
            move(floor, mover, motion)
        return floor, mover

    def is_possible(self) -> bool:
        player = Player(self.state, self.run, {}, free=True)
        return Scene(self.state, CELL, 0).find_in_the_way(player, 0) is None

    def on_paper(self) -> tuple[list[str], DryRun]:
        """What a dry run finds wrong, and its paper afterwards."""
        faults: list[str] = []
        cell, bench = self.bench.cell, self.state.bench

        def tell(index: int, message: str, remedy: str) -> None:
            faults.append(message)

        def warn(index: int, message: str, remedy: str) -> None:
            """What may yet be put right by a person is no fault."""

        stock = {name: station.stock[-1] for name, station in bench.stations.items() if station.stock}
        modules = {spec.name: spec for spec in cell.modules}
        dry = DryRun(Stations(CELL, cell.stations), modules, {}, stock, None, tell, warn)
        dry.variables = {name: at.values for name, at in self.state.modules.by_name.items()}
        nearest_last = (SHARED, USERS, MINE)
        for station in bench.stations.values():
            items = [bench.labware[name] for name in station.labware]
            items = [item for item in items if item.owner in nearest_last]
            if station.spec.kind != "stack":
                items.sort(key=lambda item: nearest_last.index(item.owner))
            for item in () if station.spec.hotel else items:
                piece = Piece(item.type, fresh=True)
                piece.variables = dict(item.variables)
                piece.lid = Piece(bench.labware[item.lid].type, fresh=True) if item.lid else None
                dry.at.setdefault(station.spec.name, []).append(piece)
        dry.run([(0, self.step)])
        return faults, dry

    def carry_out(self) -> None:
        """Start the step, and let it succeed."""
        self.do(StartStep(self.run.id, 0, ActionId("A9"), 0))

    def finish(self) -> None:
        self.do(FinishAction(ActionId("A9"), 1, True, "all"))

    def do(self, command: Any) -> None:
        def write(event: Event) -> Event:
            evolve(self.state, event, self.state.position + 1, self.state.recorded_at)
            return event

        answer = carry_out(self.state, command, write, LABOS)
        assert not isinstance(answer, Rejection), answer


def describe_floor(floor: Floor, mover: Actor) -> dict[str, Any]:
    """What a floor says of places, without what is nought."""

    def some(table: dict[Any, int]) -> dict[Any, int]:
        return {key: number for key, number in table.items() if number}

    return {
        "count": some(floor.count),
        "stock": some(floor.stock),
        "own": some(mover.own),
        "claimed": {claim: some(who) for claim, who in floor.claimed.items() if some(who)},
        "pools": {owner: some(places) for owner, places in floor.pools.items() if some(places)},
        "piles": {place: pile for place, pile in floor.piles.items() if pile},
        "lent": Counter(floor.lent.get(mover.name, ())),
    }


def list_standing(bench: Bench) -> Counter[tuple[str, str, bool]]:
    """Where what R1 may use stands, of which type, and whether with a lid."""
    usable = (MINE, USERS, SHARED)
    return Counter(
        (bench.find_planned_place(item.station), item.type, bool(item.lid))
        for item in bench.labware.values()
        if item.owner in usable and item.station
    )


def on_paper(dry: DryRun) -> Counter[tuple[str, str, bool]]:
    return Counter(
        (place, piece.kind, piece.lid is not None)
        for place, pieces in dry.at.items()
        for piece in pieces
        if dry.stations[place].kind != "waste"
    )


def disagreement(trial: Trial) -> str:
    """What they do not agree about; empty if they agree."""
    code = trial.code
    touches = any(isinstance(effect, Carrying | Needs) for effect in trial.step.effects)
    after = trial.move() if touches else None
    faults, dry = trial.on_paper()
    rehearsed = trial.is_possible()
    if code:
        known = code in OF_PLACES and trial.is_clear
        if touches and known and after is not None:
            return f"the rules say {code}, and the floor lets it be"
        if known and rehearsed:
            return f"the rules say {code}, and the scene lets it be"
        if trial.bench.alone and code in OF_LABWARE and not trial.meets_stock and not faults:
            return f"the rules say {code}, and the dry run finds nothing"
        return ""
    if touches and after is None:
        if trial.state.bench.lost:
            return ""  # safety keeps room wherever it may be, however often that is
        return "the rules let it be, and the floor does not"
    if not rehearsed:
        return "the rules let it be, and the scene does not"
    if faults:
        return f"the rules let it be, and the dry run says: {faults[0]}"
    trial.carry_out()
    flying = describe_floor(*trial.floor())
    trial.finish()
    done = describe_floor(*trial.floor())
    if flying != done:
        return f"the floor sees an action in flight as {flying}, and afterwards {done}"
    if after is not None and describe_floor(*after) != done:
        return f"the floor moves to {describe_floor(*after)}, the log to {done}"
    if on_paper(dry) != list_standing(trial.state.bench):
        return f"on paper {on_paper(dry)} stands there, on the bench {list_standing(trial.state.bench)}"
    return ""


def disagreements(first: int, count: int) -> tuple[list[str], Counter[str]]:
    """What they do not agree about on so many benches, half of them with nobody else there, and how often
    the rules said what."""
    found: list[str] = []
    codes: Counter[str] = Counter()
    for alone in (False, True):
        for seed, bench in benches(first, count // 2, alone=alone):
            trial = Trial(bench)
            codes[trial.code] += 1
            wrong = disagreement(trial)
            if wrong:
                effects = " ".join(map(repr, trial.step.effects))
                found.append(f"seed {seed}{' alone' if alone else ''}: {wrong}: {effects}")
    return found, codes


def test_rules_floor_scene_and_dry_run_agree() -> None:
    found, codes = disagreements(0, FEW)
    assert not found, "\n".join(found[:5])
    assert codes[""] > FEW / 10, codes
    assert set(codes) >= OF_PLACES | OF_LABWARE, codes


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_they_agree_on_100_000_benches(capsys: pytest.CaptureFixture[str]) -> None:
    found, codes = disagreements(1_000_000, MANY)
    with capsys.disabled():
        print(f"\n{sum(codes.values())} benches, {len(found)} disagreements; the rules said {codes}")
    assert not found, "\n".join(found[:20])
