"""Where a run may wait before a step, whatever it waits within the limits, all its windows are kept."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from itertools import product

from labos.planning.window_waits import WaitSpan, share_waits

LONGEST = 4


def is_kept(waits: Sequence[int], spans: Sequence[WaitSpan]) -> bool:
    sums = [(span, sum(waits[span.first : span.last + 1])) for span in spans]
    return all(span.least <= waited and (span.most is None or waited <= span.most) for span, waited in sums)


def some_spans(rng: random.Random, count: int) -> Iterator[WaitSpan]:
    for _ in range(rng.randint(1, 4)):
        first = rng.randrange(1, count)
        least = rng.randint(-1, LONGEST)
        most = least + rng.randint(-1 if least > 0 else 0, 2)
        yield WaitSpan(first, rng.randrange(first, count), least, rng.choice([None, most, most]))


def test_windows_side_by_side_and_within_one_another() -> None:
    """At most 30 before the first step, and at least 400 before the first two: the second one waits."""
    assert share_waits(3, [WaitSpan(1, 1, 0, 30), WaitSpan(1, 2, 400, 460)]) == (
        (0, 0, 400),
        (None, 30, 430),
    )


def test_what_is_left_over_is_waited_before_the_first_step() -> None:
    assert share_waits(3, [WaitSpan(1, 2, 0, 60)]) == ((0, 0, 0), (None, 60, 0))


def test_windows_that_contradict_one_another_are_told() -> None:
    assert share_waits(3, [WaitSpan(1, 1, 30, None), WaitSpan(1, 2, 0, 20)]) is None
    assert share_waits(2, [WaitSpan(1, 1, 0, -1)]) is None


def test_all_windows_are_kept_within_the_limits() -> None:
    impossible = 0
    for seed in range(400):
        rng = random.Random(seed)
        count = rng.randint(2, 5)
        spans = list(some_spans(rng, count))
        found = share_waits(count, spans)
        if found is None:
            assert not any(is_kept(waits, spans) for waits in product(range(9), repeat=count)), seed
            impossible += 1
            continue
        choices = [
            range(low, (low + 2 if high is None else high) + 1) for low, high in zip(*found, strict=True)
        ]
        assert all(choices), seed
        assert all(is_kept(waits, spans) for waits in product(*choices)), (seed, spans, found)
    assert 20 < impossible < 380
