"""Certificates of windows: whether a run can keep them for all durations of its steps."""

from __future__ import annotations

import itertools
import random
import time

import msgspec
import pytest

from labos.core.model import Plan, PlanStep, Window
from labos.planning.certificate import StepTime, certify
from tests.support.bench import plan, step
from tests.unit.planning.window_game import OPEN, Game, State


def make_lasting(what: PlanStep, seconds: float, *windows: Window) -> PlanStep:
    return msgspec.structs.replace(what, duration_s=seconds, windows=windows)


def test_a_window_breaks_where_what_comes_between_takes_too_long() -> None:
    what = plan(
        make_lasting(step("dose"), 10),
        make_lasting(step("seal"), 30),
        make_lasting(step("read"), 5, Window(0, within_s=32)),
    )
    [kept] = certify(what, spread=0.05).windows
    assert (kept.is_kept, kept.path) == (True, ())
    [broken] = certify(what).windows
    assert (broken.step, broken.anchor, broken.breaks_by_s) == (what.steps[2].key, what.steps[0].key, 1.0)
    assert broken.path == (StepTime(what.steps[1].key, 33.0),)


def test_a_clock_is_started_late_enough_for_what_is_beside_it() -> None:
    beside = [make_lasting(step("a"), 5), make_lasting(step("b"), 50)]
    read = make_lasting(step("c", after=(0, 1)), 1, Window(0, within_s=0))
    [window] = certify(plan(*beside, read, parallel=True)).windows
    assert window.is_kept


def test_two_that_must_end_at_about_the_same_time_depend_on_their_spread() -> None:
    beside = [make_lasting(step("a"), 50), make_lasting(step("b"), 50)]
    read = make_lasting(step("c", after=(0, 1)), 1, Window(0, within_s=8), Window(1, within_s=8))
    found = certify(plan(*beside, read, parallel=True))
    assert [window.breaks_by_s for window in found.windows] in ([0, 4], [0, 2], [2, 2], [4, 0], [2, 0])
    assert certify(plan(*beside, read, parallel=True), spread=0.08).is_kept


def test_steps_on_one_module_exclude_each_other() -> None:
    apart = [make_lasting(step("a"), 10), make_lasting(step("b"), 60)]
    read = make_lasting(step("b", after=(0,)), 1, Window(0, within_s=20))
    [window] = certify(plan(*apart, read, parallel=True)).windows
    assert window.is_kept  # the first one on b is done before a ends


def test_a_wait_counts_and_can_be_kept() -> None:
    what = plan(
        make_lasting(step("a"), 5),
        make_lasting(step("b"), 10, Window(0, wait_s=60)),
        make_lasting(step("c"), 1, Window(0, within_s=70)),
    )
    wait, within = certify(what).windows
    assert (wait.is_kept, within.breaks_by_s) == (True, 1.0)
    assert certify(what, spread=0.0).is_kept


def test_what_another_run_starts_is_left_out() -> None:
    what = plan(make_lasting(step("a"), 5, Window(None, within_s=1, of="other", of_step="x")))
    found = certify(what)
    assert (found.windows, found.left_out, found.is_kept) == ((), (what.steps[0].key,), True)


def test_long_plans_take_little_time() -> None:
    steps = [make_lasting(step(f"m{n % 7}"), 10, Window(max(0, n - 4), within_s=35)) for n in range(1, 61)]
    what = plan(make_lasting(step("m0"), 10), *steps)
    took = []
    for _ in range(3):
        begun = time.perf_counter()
        certify(what)
        took.append(time.perf_counter() - begun)
    assert min(took) < 0.3  # 13 ms where it was written


def random_plan(rng: random.Random) -> tuple[Plan, list[tuple[int, int]]]:
    """Up to five steps on three modules, with short durations and windows."""
    steps: list[PlanStep] = []
    ranges: list[tuple[int, int]] = []
    for n in range(rng.randint(2, 5)):
        before = tuple(b for b in range(n) if rng.random() < 0.45)
        windows = []
        for anchor in before:
            if rng.random() < 0.7:
                wait = rng.choice((0, 0, 0, 1, 2))
                most = None if wait and rng.random() < 0.3 else wait + rng.randint(0, 4)
                windows.append(Window(anchor, wait_s=wait, within_s=most))
        steps.append(make_lasting(step(rng.choice("abcd"), after=before), 1, *windows))
        least = rng.randint(1, 3)
        ranges.append((least, least + rng.choice((0, 1, 1, 2, 3))))
    return plan(*steps, parallel=True), ranges


def widen(what: Plan, seconds: dict[tuple[int, str], float]) -> Plan:
    keys = [s.key for s in what.steps]
    return msgspec.structs.replace(
        what,
        steps=tuple(
            msgspec.structs.replace(
                s,
                windows=tuple(
                    w
                    if w.within_s is None or w.anchor is None
                    else msgspec.structs.replace(w, within_s=w.within_s + seconds.get((i, keys[w.anchor]), 0))
                    for w in s.windows
                ),
            )
            for i, s in enumerate(what.steps)
        ),
    )


def play(game: Game, rng: random.Random, *, careful: bool, extremes: bool) -> bool:
    """One run with random durations; whether it kept its windows. Steps start as early as they may; if not
    ``careful``, whatever comes of it."""
    lasts = [rng.choice(r) if extremes else rng.randint(*r) for r in game.ranges]
    state: State = game.first
    while OPEN in state:
        if game.is_missed(state):
            return False
        chosen = game.choose(state) if careful else next(game.moves(state))
        assert chosen is not None
        later = game.tick(chosen)
        state = game.end(later, [i for i, s in enumerate(later) if s >= 0 and s >= lasts[i]])
    return True


def test_ten_thousand_runs_agree_with_their_certificates() -> None:
    rng = random.Random(20261125)
    runs = kept = broken = 0
    while runs < 10_000:
        what, ranges = random_plan(rng)
        game = Game(what, ranges)
        found = certify(what, ranges=ranges)
        assert found.is_kept == game.wins(game.first), (what, ranges)
        if found.is_kept:
            kept += 1
            for number in range(20):
                assert play(game, rng, careful=True, extremes=number % 2 == 0), (what, ranges)
            runs += 20
            continue
        broken += 1
        wider = {(w.index, w.anchor): w.breaks_by_s for w in found.windows}
        assert certify(widen(what, wider), ranges=ranges).is_kept
        assert Game(widen(what, wider), ranges).wins(game.first)
        if sum(w.within_s is not None for w in found.windows) == 1:  # then it is the least that helps
            almost = {key: value - 1 for key, value in wider.items() if value}
            assert not Game(widen(what, almost), ranges).wins(game.first)
    assert min(kept, broken) > 100


@pytest.mark.parametrize("seed", range(3))
def test_refused_plans_are_missed_by_some_run(seed: int) -> None:
    rng = random.Random(seed)
    found = 0
    while found < 100:
        what, ranges = random_plan(rng)
        if certify(what, ranges=ranges).is_kept:
            continue
        found += 1
        game = Game(what, ranges)
        every = itertools.product(*(range(low, high + 1) for low, high in ranges))
        assert any(is_missed_with(game, lasts) for lasts in every), (what, ranges)


def is_missed_with(game: Game, lasts: tuple[int, ...]) -> bool:
    """Whether a lab that starts all as early as it may misses a window with these durations."""
    fixed = Game(game.plan, [(n, n) for n in lasts])
    return not play(fixed, random.Random(0), careful=False, extremes=True)
