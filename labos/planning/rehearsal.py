"""Simulates a workcell from now on, with the usual duration of each step.

Players are runs with steps that have to start by a deadline, because clocks of their windows run, and runs
that have to make room for them. All other runs start nothing. A step starts as soon as it can, the most
urgent one first, unless the ``Advice`` makes it wait.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import Any

import msgspec

from labos.core.runs import PENDING
from labos.planning.forecast import find_run, find_usual_time
from labos.planning.player import FAR, Player, Step, Who
from labos.planning.scene import Scene


class Advice(msgspec.Struct, frozen=True):
    """What a simulation does differently. A step starts only after other steps have started (``behind``), or
    not before a time (UTC ns). Runs that are ``leaving`` go on to their end to make room."""

    behind: dict[Step, tuple[Step, ...]] = {}
    not_before: dict[Step, int] = {}
    leaving: frozenset[str] = frozenset()

    def put_behind(self, step: Step, other: Step) -> Advice:
        """The same advice, but a step waits until another one has started."""
        behind = {**self.behind, step: (*self.behind.get(step, ()), other)}
        return msgspec.structs.replace(self, behind=behind)

    def put_off(self, step: Step, until: int) -> Advice:
        """The same advice, but a step does not start before a time (UTC ns)."""
        return msgspec.structs.replace(self, not_before={**self.not_before, step: until})

    def let_leave(self, run: str) -> Advice:
        """The same advice, but a run goes on to its end."""
        return msgspec.structs.replace(self, leaving=self.leaving | {run})


NO_ADVICE = Advice()


class RehearsalResult(msgspec.Struct):
    """The result of a simulation. ``starts`` are when steps started (UTC ns). ``late`` are windowed steps
    that started after their deadline, and by how much (ns), the earliest deadline first. Steps that had to
    start but never did are in it too, with FAR. ``blame`` lists what a step waited for that could not start
    at once. ``due`` are the deadlines of windowed steps (UTC ns). ``trap`` is the first start after which
    some runs could never end, with these runs. ``will_be_late`` is a step whose clock has not begun, but
    which would be late after all these starts."""

    starts: dict[Step, int] = {}
    late: dict[Step, int] = {}
    blame: dict[Step, dict[Who, bool]] = {}
    due: dict[Step, int] = {}
    trap: tuple[Step, tuple[str, ...]] | None = None
    will_be_late: Step | None = None


def play(
    scene: Scene, players: Iterable[Player], advice: Advice, forced: Step | None = None
) -> RehearsalResult:
    """Simulate a scene until no step has to start any more, or nothing more can happen. ``forced`` starts at
    once, whatever the advice says. Changes the scene and the players."""
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
            scene.release(cast.get(who[0]), find_run(scene.state, who[0]), who, step, effects)
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
    """Start all steps that can start. Returns the times at which further steps may start (UTC ns), for those
    that wait only for a time."""
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
