"""Five instances of scheduling for laboratory automation in biology (S-LAB), which others have published.

Source of the figures: T. D. Itoh, T. Horinouchi, H. Uchida, K. Takahashi, H. Ozaki, *Optimal scheduling for
laboratory automation of life science experiments with time constraints*, SLAS Technology 26 (2021) 650–659,
doi 10.1177/24726303211021790; and Y. Arai, K. Takahashi, T. Horinouchi, K. Takahashi, H. Ozaki, *SAGAS:
simulated annealing and greedy algorithm scheduler for laboratory automation*, SLAS Technology 28 (2023)
264–277, doi 10.1016/j.slast.2023.03.001, with the data in github.com/bioinfo-tsukuba/SAGAS_paper. Operations,
durations, instruments and time constraints are theirs; the published makespans are the shortest among the
results there. One of their units is taken as one minute.

An operation may be carried out by any instrument of its type. An instrument takes the next operation one
minute after it has ended one (all published schedules keep that). A time constraint says how long after the
end of one operation another starts at most. Where samples stand between operations is not limited.

Here each type of instrument is one module, and a bank of as many places as there are instruments. An
operation takes a place of the bank at its start; a second step of one minute gives it free. (``module: any``
would bind a whole run to one instrument of each type, which is another, narrower problem.)
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from labos.core.model import Plan, PlanStep, Window, Workcell
from tests.benchmarks.league.play import Work
from tests.support.bench import full, module, move, plan, station, step, take, workcell

MINUTE_S = 60.0


class Protocol(msgspec.Struct, frozen=True):
    """One job: (type of instrument, minutes) of each operation; pairs of operations (numbered from 1) of
    which the first ends before the second starts; and (first, second, minutes) of time constraints. The steps
    of a run are written down as they are numbered, or ``in_time``."""

    operations: tuple[tuple[str, int], ...]
    before: tuple[tuple[int, int], ...]
    within: tuple[tuple[int, int, int], ...]
    in_time: bool = False


class Instance(msgspec.Struct, frozen=True):
    """``instruments`` is how many there are of each type; ``published`` the shortest makespan (minutes)."""

    name: str
    instruments: Mapping[str, int]
    jobs: tuple[Protocol, ...]
    published: int


def _chain(first: int, last: int) -> list[tuple[int, int]]:
    return [(number, number + 1) for number in range(first, last)]


def _operations(text: str) -> tuple[tuple[str, int], ...]:
    words = (word.split(":") for word in text.split())
    return tuple((name, int(minutes)) for name, minutes in words)


SCREENING = Protocol(
    _operations(
        "carrier:2 reformatter:12 carrier:3 motoman:7 carrier:6 biomek_a3:24 carrier:2 carrier:3 "
        "biomek_a4:16 carrier:2 carrier:5 reformatter:20 carrier:5 biomek_a3:19 carrier:2 carrier:5 "
        "reformatter:3"
    ),
    (
        *[(1, 2), (3, 4), (5, 6), (2, 7), (4, 8), (4, 10), (6, 11), (7, 9), (8, 9), (2, 12)],
        *[(10, 12), (11, 12), (9, 15), (12, 13), (13, 14), (14, 16), (12, 17), (15, 17), (16, 17)],
    ),
    ((2, 9, 10), (4, 9, 10), (4, 12, 10), (6, 12, 10), (12, 14, 10), (14, 17, 10)),
)
"""A screening assay on a robotic system (*Gu2016*)."""

QPCR = Protocol(
    _operations(
        "carrier:1 carrier:1 tecan_1:5 tecan_2:15 carrier:1 centrifuge:1 carrier:1 carrier:1 centrifuge:1 "
        "carrier:1 tecan_3:5 carrier:1 centrifuge:1 carrier:1 qpcr:40 carrier:1"
    ),
    (
        *[(1, 3), (2, 4), (4, 5), (5, 6), (6, 7), (3, 8), (8, 9), (9, 10), (7, 11), (10, 11)],
        *_chain(11, 16),
    ),
    tuple(
        (first, second, 5)
        for first, second in [
            *[(1, 3), (2, 4), (4, 5), (5, 6), (6, 7), (3, 8), (8, 9), (9, 10), (12, 13), (13, 14), (14, 15)]
        ]
    ),
    in_time=True,
)

RNA_SEQ = Protocol(
    _operations(
        "carrier:5 maholo:106 carrier:5 tecan:75 carrier:5 pcr:75 carrier:5 tecan:3 carrier:5 pcr:30 "
        "carrier:5 tecan:87 carrier:5 pcr:30 carrier:5 tecan:57 carrier:5 pcr:35 carrier:5 tecan:4 "
        "carrier:5 pcr:10 carrier:5 tecan:33 carrier:5 pcr:45 carrier:5 tecan:45"
    ),
    tuple(_chain(1, 28)),
    tuple((first, first + 1, 5) for first in (1, 4, 5, 9, 10, 13, 14, 16, 17, 21, 22, 25, 26)),
)

_SCREEN = {"biomek_a4": 1, "reformatter": 1, "motoman": 1, "biomek_a3": 1, "carrier": 2}
_QPCR = {"tecan_1": 1, "tecan_2": 1, "tecan_3": 1, "centrifuge": 1, "qpcr": 2}

INSTANCES = (
    Instance("Gu2016 × 1", _SCREEN, (SCREENING,), 87),
    Instance("Gu2016 × 5", _SCREEN, (SCREENING,) * 5, 386),
    Instance("qPCR × 5", {**_QPCR, "carrier": 1}, (QPCR,) * 5, 152),
    Instance("RNA-seq × 5", {"maholo": 2, "carrier": 4, "tecan": 2, "pcr": 10}, (RNA_SEQ,) * 5, 1053),
    Instance(
        "qPCR × 5 + RNA-seq × 5",
        {**_QPCR, "maholo": 2, "carrier": 2, "tecan": 2, "pcr": 2},
        (*[RNA_SEQ] * 3, *[QPCR] * 3, *[RNA_SEQ] * 2, *[QPCR] * 2),
        1145,
    ),
)
"""Jobs in the order in which they are numbered there."""


def cell_of(instance: Instance) -> Workcell:
    banks = [station(f"{kind}_bank", capacity=count) for kind, count in instance.instruments.items()]
    return workcell(
        [module(kind) for kind in instance.instruments],
        [station("stack", "stack", STOCK), *banks, station("trash", "waste", STOCK)],
    )


def works_of(instance: Instance) -> tuple[Work, ...]:
    return tuple(Work((SubmitRun(_plan(protocol), "ada"),)) for protocol in instance.jobs)


STOCK = 400


def stock() -> dict[StationName, tuple[str, int]]:
    return {StationName(full("stack")): ("plate", STOCK)}


def _plan(protocol: Protocol) -> Plan:
    """Two steps for each operation: it, and what sets its instrument free."""
    order = [(begin, number + 1) for number in range(len(protocol.operations)) for begin in (True, False)]
    if protocol.in_time:
        starts = _starts_alone(protocol)
        lasts = {number: protocol.operations[number - 1][1] for number in starts}
        order.sort(key=lambda item: (starts[item[1]] + (0 if item[0] else lasts[item[1]]), *item))
    index = {item: position for position, item in enumerate(order)}
    steps: list[PlanStep] = []
    for begin, number in order:
        kind, minutes = protocol.operations[number - 1]
        if not begin:
            effect = move(f"{kind}_bank", "trash")
            after: tuple[int, ...] = (index[True, number],)
            steps.append(
                step(kind, effect, key=f"free {number}", duration_s=MINUTE_S, exclusive=False, after=after)
            )
            continue
        after = tuple(sorted(index[True, first] for first, second in protocol.before if second == number))
        windows = tuple(
            Window(index[True, first], 0.0, most * MINUTE_S)
            for first, second, most in protocol.within
            if second == number
        )
        steps.append(
            step(
                kind,
                take("stack", f"{kind}_bank"),
                key=f"operation {number}",
                duration_s=minutes * MINUTE_S,
                exclusive=False,
                after=after,
                windows=windows,
            )
        )
    return plan(*steps, name=f"{len(protocol.operations)} operations", parallel=True)


def _starts_alone(protocol: Protocol) -> dict[int, int]:
    """When each operation starts (minutes) if its job is alone with one instrument of each type."""
    free = {kind: 0 for kind, _ in protocol.operations}
    starts: dict[int, int] = {}
    ends: dict[int, int] = {}
    while len(starts) < len(protocol.operations):
        found: list[tuple[int, int]] = []
        for number, (kind, _) in enumerate(protocol.operations, start=1):
            before = [first for first, second in protocol.before if second == number]
            if number not in starts and all(first in ends for first in before):
                found.append((max([free[kind], *(ends[first] for first in before)]), number))
        at, number = min(found)
        kind, minutes = protocol.operations[number - 1]
        starts[number], ends[number] = at, at + minutes
        free[kind] = at + minutes + 1
    return starts
