"""The league side by side: ``python -m tests.benchmarks.league.table [NAME…]``.

One line for each case: what others have published, the best that is known, what planning makes of it without
a planner and with one (needs the extra ``plan``), each with the number of missed windows; then for each
family which of the limits it reaches. Seconds of lab time. The planner's seconds are counted, so the table is
the same on every computer, however busy it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from tests.benchmarks.figures import times
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.score import MUST, MUST_PLANNED, Score, score

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
    together = "nothing starts online before all is submitted, as with the planner"
    parser.add_argument("--together", action="store_true", help=together)
    options = parser.parse_args()
    online: list[Score] = []
    planned: list[Score] = []
    print(_line(*HEADINGS))
    print(_line(*["---"] * len(HEADINGS)))
    for case in cases():
        if _is_wanted(case, options.names):
            online.append(score(case, together=options.together))
            if not options.online:
                planned.append(score(case, planner=True))
            print(row(online[-1], planned[-1] if planned else None), flush=True)
    print(*verdicts(online, planned), sep="\n")


if __name__ == "__main__":
    main()
