"""The league side by side: ``python -m tests.benchmarks.league.table [NAME…] [--keep FILE]``.

One line for each case: what others have published, the best that is known, what planning makes of it without
a planner and with one (needs the extra ``plan``), each with the number of missed windows; then for each
family which of the limits it reaches. Seconds of lab time. The planner's seconds are counted, so the table is
the same on every computer, however busy it is. What was played is written to the file that is kept at once: a
table that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import msgspec

from tests.benchmarks.figures import times
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.score import MUST, MUST_PLANNED, PLANNER_S, Score, read_best, score

HEADINGS = ("family", "case", "published", "best known", "online", "ratio", "with planner", "ratio")


def row(online: Score, planned: Score | None) -> str:
    """A line of the table."""
    case, best = online.case, online.best
    return _line(
        case.family,
        case.name,
        f"{case.published_s:,.0f}" if case.published_s else "–",
        _cell(best.makespan_s, best.missed) if best is not None else "–",
        _cell(online.makespan_s, online.missed),
        times(online.ratio),
        _cell(planned.makespan_s, planned.missed) if planned is not None else "–",
        times(planned.ratio) if planned is not None else "–",
    )


def verdicts(online: list[Score], planned: list[Score]) -> Iterator[str]:
    """For each family whether every case of it is within the limits and misses no window needlessly."""
    limits = (("online", online, MUST), ("with planner", planned, MUST_PLANNED))
    for family in dict.fromkeys(each.case.family for each in online):
        for what, scores, must in limits:
            found = [each for each in scores if each.case.family == family]
            if not found:
                continue
            worst, late = max(each.ratio for each in found), sum(each.too_many_missed for each in found)
            reached = "reached" if worst <= must and not late else "not reached"
            yield f"{family}, {what}: {times(must)} {reached} (at worst {worst:.3f} ×, {late} missed)"


class Kept(msgspec.Struct, frozen=True):
    """One line of the file that is kept: what came of a case, online (``seconds`` 0) or with a planner that
    looked for so long each time."""

    case: str
    seconds: float
    makespan_s: float
    missed: int


class Keeper:
    """Plays cases, but for those that the file has. It does not say which planning it is of: begin a new one
    where planning has changed."""

    def __init__(
        self, file: Path | None, seconds: float, *, together: bool = True, by_age: bool = False
    ) -> None:
        self.file, self.seconds, self.together, self.by_age = file, seconds, together, by_age
        self._kept: dict[tuple[str, float], Kept] = {}
        if file is not None and file.exists():
            for line in file.read_text().splitlines():
                kept = msgspec.json.decode(line, type=Kept)
                self._kept[kept.case, kept.seconds] = kept

    def score(self, case: Case, *, planner: bool) -> Score:
        seconds = self.seconds if planner else 0.0
        kept = self._kept.get((case.name, seconds))
        if kept is not None:
            return Score(case, kept.makespan_s, kept.missed, read_best().get(case.key))
        found = score(case, planner=planner, seconds=self.seconds, together=self.together, by_age=self.by_age)
        if self.file is not None:
            line = msgspec.json.encode(Kept(case.name, seconds, found.makespan_s, found.missed)).decode()
            with self.file.open("a") as out:
                out.write(line + "\n")
        return found


def _cell(seconds: float, missed: int) -> str:
    return f"{seconds:,.0f}" + (f" ({missed} missed)" if missed else "")


def _line(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _is_wanted(case: Case, names: list[str]) -> bool:
    return not names or any(name in case.name or name == case.family for name in names)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.league.table", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="families, or parts of names; all if none")
    parser.add_argument("--online", action="store_true", help="without the planner only")
    one_by_one = "runs are submitted one after the other: the first starts before the next is known"
    by_age = "the lab looks for no order of its own, as with LABOS_ORDER=age"
    parser.add_argument("--by-age", action="store_true", help=by_age)
    parser.add_argument("--one-by-one", action="store_true", help=one_by_one)
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="write each result there at once; play no case twice"
    )
    parser.add_argument(
        "--seconds", type=float, default=PLANNER_S, help="how long the planner may look each time, counted"
    )
    options = parser.parse_args()
    keeper = Keeper(options.keep, options.seconds, together=not options.one_by_one, by_age=options.by_age)
    online: list[Score] = []
    planned: list[Score] = []
    print(_line(*HEADINGS))
    print(_line(*["---"] * len(HEADINGS)))
    for case in cases():
        if _is_wanted(case, options.names):
            online.append(keeper.score(case, planner=False))
            if not options.online:
                planned.append(keeper.score(case, planner=True))
            print(row(online[-1], planned[-1] if planned else None), flush=True)
    print(*verdicts(online, planned), sep="\n")


if __name__ == "__main__":
    main()
