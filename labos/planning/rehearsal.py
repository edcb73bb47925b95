"""What would happen from now on if all steps took their nominal time: a workcell played forward.

Players are runs with steps that have to be started by a time (their windows' clocks run), and runs
that have to make room for them. Everybody else stays where they are. A step starts as soon as it can, the
most urgent one first, unless it is told to wait (``Advice``).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import Any

import msgspec

from labos.core.ids import RunId
from labos.core.runs import PENDING
from labos.planning.forecast import find_usual_time
from labos.planning.player import FAR, Player, Step, Who
from labos.planning.scene import Scene


class Advice(msgspec.Struct, frozen=True):
    """Which steps are not to start before another one has started, or before a time (UTC ns), and which
    runs go on to their end to make room."""

    behind: dict[Step, tuple[Step, ...]] = {}
    not_before: dict[Step, int] = {}
    leaving: frozenset[str] = frozenset()

    def put_behind(self, step: Step, other: Step) -> Advice:
        """The same, but a step waits until another one has started."""
        behind = {**self.behind, step: (*self.behind.get(step, ()), other)}
        return msgspec.structs.replace(self, behind=behind)

    def put_off(self, step: Step, until: int) -> Advice:
        """The same, but a step does not start before a time."""
        return msgspec.structs.replace(self, not_before={**self.not_before, step: until})

    def let_leave(self, run: str) -> Advice:
        """The same, but a run goes on to its end."""
        return msgspec.structs.replace(self, leaving=self.leaving | {run})


NO_ADVICE = Advice()


class RehearsalResult(msgspec.Struct):
    """How it went: when each step started (UTC ns); which windowed steps were late, and by how much (ns;
    FAR: they never started), the first one first; for whom each step had to wait that could not start at
    once; by when the windowed steps had to start. ``trap`` is the first start after which some runs could
    never come to their ends, and which runs these are. ``tangle`` is a step whose clock has not begun, but
    which could not follow in time after all these starts."""

    starts: dict[Step, int] = {}
    late: dict[Step, int] = {}
    blame: dict[Step, dict[Who, bool]] = {}
    due: dict[Step, int] = {}
    trap: tuple[Step, tuple[str, ...]] | None = None
    tangle: Step | None = None


def play(
    scene: Scene, players: Iterable[Player], advice: Advice, forced: Step | None = None
) -> RehearsalResult:
    """Play a scene forward until nothing has to be started any more, or nothing goes on. ``forced`` starts
    at once, whatever the advice. Changes scene and players."""
    cast = {player.name: player for player in players}
    outcome, now = RehearsalResult(), scene.now

    def start(player: Player, index: int) -> None:
        step = player.plan.steps[index]
        end = now + find_usual_time(scene.state, step)
        scene.take(player.run, index, step, step.effects, end)
        player.start(index, end)
        outcome.starts[player.name, index] = now

    if forced is not None:
        start(cast[forced[0]], forced[1])
    while True:
        later = _start_all(scene, cast, advice, outcome, now, start)
        if not any(player.left for player in cast.values()):
            break
        later += [end for end, *_ in scene.flying[:1]]
        now = min(later, default=FAR)
        if now >= FAR:
            break
        while scene.flying and scene.flying[0][0] <= now:
            _, _, who, step, effects = heapq.heappop(scene.flying)
            run = scene.state.runs.get(RunId(who[0]))
            assert run is not None
            scene.release(cast.get(who[0]), run, who, step, effects)
    for player in cast.values():
        for index, due in player.due.items():
            outcome.due[player.name, index] = due
            begun = outcome.starts.get((player.name, index))
            if begun is not None and begun > due:
                outcome.late[player.name, index] = begun - due
        outcome.late.update({(player.name, index): FAR for index in player.left})
    outcome.late = dict(sorted(outcome.late.items(), key=lambda item: (outcome.due.get(item[0], FAR), item)))
    return outcome


def _start_all(
    scene: Scene, cast: dict[str, Player], advice: Advice, outcome: RehearsalResult, now: int, start: Any
) -> list[int]:
    """Start what can start; returns when the next ones may, as far as that is a question of time only."""
    later: list[int] = []
    moved = True
    while moved:
        moved, later = False, []
        turns = [
            (player.latest.get(i, FAR), player.run.position, i, player)
            for player in cast.values()
            for i in player.list_turns()
        ]
        for _, _, index, player in sorted(turns, key=lambda turn: turn[:3]):
            who = (player.name, index)
            at = max(player.may_start_at(index), advice.not_before.get(who, 0))
            if at > now:
                later.append(at)
                continue
            if any(
                first not in outcome.starts and _is_pending(cast, first)
                for first in advice.behind.get(who, ())
            ):
                continue
            found = scene.find_in_the_way(player, index)
            if found is not None:
                outcome.blame.setdefault(who, {})[found] = True
                continue
            start(player, index)
            moved = True
    return later


def _is_pending(cast: dict[str, Player], who: Step) -> bool:
    player = cast.get(who[0])
    return player is not None and player.steps[who[1]] == PENDING
