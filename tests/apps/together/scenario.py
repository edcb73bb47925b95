"""The applications at the same time, to their ends, whatever is killed meanwhile."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from labos.client import LabUnreachable
from tests.apps.support import unclean
from tests.apps.together.bench import Bench, Operator
from tests.apps.together.kills import Kill, Killer
from tests.apps.together.programs import App, Program
from tests.apps.together.results import check_results
from tests.apps.together.sinks import Sinks
from tests.apps.together.truth import check_bench, check_log, check_owners, count_together
from tests.support.lab_process import until

LOOK_S = 0.1
LONGEST_S = 900.0


class Outcome(NamedTuple):
    """What came of it: seconds, events, how many of them while all experiments were open, what was killed,
    how much was done, what each application found, which events the sinks hold twice, and what the operator
    was asked."""

    seconds: float
    events: int
    together: int
    killed: list[str]
    not_killed: list[str]
    lives: dict[str, int]
    done: dict[str, int]
    results: dict[str, str]
    sent_twice: dict[str, int]
    asked: list[tuple[str, str]]

    def lines(self) -> list[str]:
        """As it is told to a person."""
        did = ", ".join(f"{count} {what}" for what, count in self.done.items())
        twice = ", ".join(f"{name}: {count}" for name, count in self.sent_twice.items())
        return [
            f"{self.seconds:.0f} s, {self.events} events, {self.together} of them with all under way, {did}",
            *(f"killed: {each}" for each in self.killed),
            *(f"not killed: {each}" for each in self.not_killed),
            *(f"{name} ({self.lives[name]} lives): {told}" for name, told in self.results.items()),
            f"events that the sinks hold twice: {twice}",
            f"questions to the operator: {len(self.asked)}",
            *(f"  {text} {told}" for text, told in self.asked),
        ]


def run_together(
    folder: Path,
    apps: Sequence[App],
    *,
    speed: float,
    kills: Sequence[Kill] = (),
    detach: bool = False,
    kafka: bool = False,
) -> Outcome:
    """Run applications at the same time, and kill what the plan says. Raises AssertionError if anything is
    not as it has to be afterwards."""
    cells = list(dict.fromkeys(app.cell for app in apps))
    with ExitStack() as stack:
        bench = Bench(folder, cells, speed, detach=detach)
        stack.callback(bench.close)
        bench.start(sorted({app.user for app in apps}))
        sinks = Sinks(bench.up.home, folder, kafka=kafka)
        stack.callback(sinks.close)
        sinks.start()
        operator = stack.enter_context(Operator(bench))
        programs = [Program(bench, app) for app in apps]
        begun = time.monotonic()
        with bench.client("olga") as olga:
            # Some need long to load their libraries: nothing is done before the last of them has begun.
            olga.control("pause", "lab", "olga", why="all begin together")
            for program in programs:
                stack.callback(program.kill)
                program.start()
            _await_begun(programs)
            olga.control("resume", "lab", "olga")
        killer = Killer(bench, programs, sinks, kills)
        _watch(bench, programs, killer, operator)
        seconds = time.monotonic() - begun
        not_killed = killer.finish()
        for program in programs:
            program.find()
        with bench.client("olga") as olga:
            until(lambda: not unclean(olga), "nothing is left over", 60)
        assert bench.up.interrupt() == 0, bench.up.read_log()
        records = bench.up.records()
        check_log(bench, records, programs)
        check_owners(records, programs)
        done = check_bench(bench, records)
        results = check_results(bench, programs)
        twice = sinks.check(records)
        assert not operator.failed, operator.failed
        return Outcome(
            seconds,
            len(records),
            count_together(records),
            killer.done,
            not_killed,
            {program.app.name: program.lives for program in programs},
            dict(done),
            results,
            twice,
            operator.answered,
        )


def _await_begun(programs: Sequence[Program]) -> None:
    for program in programs:
        until(lambda p=program: p.find() or p.has_ended(), f"{program.app.name} begins", 240)  # type: ignore[misc]


def _watch(bench: Bench, programs: Sequence[Program], killer: Killer, operator: Operator) -> None:
    """Until all programs are done; one that was killed is started again."""
    deadline = time.monotonic() + LONGEST_S
    with bench.client("olga", patience_s=5.0) as olga:
        while not all(program.is_done() for program in programs):
            assert time.monotonic() < deadline, _why(bench, programs, operator)
            for program in programs:
                if program.has_ended() and not program.is_done():
                    program.start()  # with --resume
            try:
                killer.look(int(olga.health()["position"]))
            except LabUnreachable:
                continue
            time.sleep(LOOK_S)


def _why(bench: Bench, programs: Sequence[Program], operator: Operator) -> Any:
    with bench.client("olga", patience_s=5.0) as olga:
        left = unclean(olga)
    said = {program.app.name: program.read_log() for program in programs if not program.has_ended()}
    return {"left": left, "said": said, "asked": operator.answered, "failed": operator.failed}
