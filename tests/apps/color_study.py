"""The study of the paper's color picker, on a simulated lab in virtual time.

    python -m tests.apps.color_study

128 samples in batches of 1 to 64, target (120, 120, 120), several seeds; then other solvers, and two and
three liquid handlers at once. Writes ``docs/color-picker-study.json``, the figure, and the page's tables.
``--draw`` only draws anew what is in the file.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from statistics import mean, stdev
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from labos.spec.library import find_specs_folder

DOCS = find_specs_folder().parent / "docs"
DATA, PICTURE, PAGE = (
    DOCS / "color-picker-study.json",
    DOCS / "pictures" / "color-picker-study.png",
    DOCS / "color-picker-study.md",
)
SAMPLES, BATCHES, TARGET = 128, (1, 2, 4, 8, 16, 32, 64), (120.0, 120.0, 120.0)
SEEDS = range(5)
PAPER, OTHERS, COMPARED = "evolutionary", ("bayesian", "grid", "random"), 8
HANDLERS = ("ot2_cp_gamma", "ot2_growth_beta", "ot2_pcr_alpha")
MORE_BATCHES = (12, 48)
T_95 = {4: 2.776}
"""Student's t for 95 %, by degrees of freedom."""


class Case(NamedTuple):
    """One experiment."""

    solver: str
    batch: int
    handlers: int
    seed: int


class Told(NamedTuple):
    """What became of it: after how many lab hours, and after how many samples, which distance was the best so
    far."""

    case: Case
    hours: list[float]
    samples: list[int]
    best: list[float]


def cases(seeds: Iterable[int] = SEEDS) -> list[Case]:
    each = [Case(PAPER, batch, 1, seed) for batch in BATCHES for seed in seeds]
    each += [Case(solver, COMPARED, 1, seed) for solver in OTHERS for seed in seeds]
    each += [
        Case(PAPER, batch, handlers, seed)
        for batch in MORE_BATCHES
        for handlers in (1, 2, 3)
        for seed in seeds
    ]
    return each


def carry_out(case: Case, samples: int = SAMPLES) -> Told:
    """One experiment in a lab of its own."""
    sys.path.append(str(find_specs_folder() / "apps" / "color_picker"))
    from color_picker import FLOWS, Search, Wanted, parkings_of

    from tests.apps.virtual_lab import VirtualExperiment, VirtualLab

    with VirtualLab("rpl_picker", case.seed) as lab:
        began = lab.now_ns()
        wanted = Wanted(
            TARGET,
            samples=samples,
            batch=case.batch,
            close=0.0,
            solver=case.solver,
            handlers=list(HANDLERS[: case.handlers]),
            bad_pictures="leave_out",
        )
        experiment = VirtualExperiment(
            lab, "color picker", "bo", closing=FLOWS / "trash_plates.yaml", parkings=parkings_of(wanted)
        )
        search = Search(lab, experiment, wanted, case.seed)  # type: ignore[arg-type]
        search.run()
    found = sorted(search.samples, key=lambda sample: sample.mixed_at)
    best = np.minimum.accumulate([sample.distance for sample in found])
    last = [
        n for n, sample in enumerate(found) if n + 1 == len(found) or found[n + 1].mixed_at > sample.mixed_at
    ]
    hours = [round((found[n].mixed_at - began) / 3.6e12, 4) for n in last]
    return Told(case, hours, [n + 1 for n in last], [round(float(best[n]), 2) for n in last])


# -- what is told of them --------------------------------------------------------------------------


def spread(values: Sequence[float]) -> str:
    """The mean with the half width of its 95 % interval."""
    if len(values) < 2:
        return f"{mean(values):.2f}"
    t = T_95.get(len(values) - 1, 2.0)
    return f"{mean(values):.2f} ± {t * stdev(values) / math.sqrt(len(values)):.2f}"


def group_by_case(found: Sequence[Told]) -> dict[tuple[str, int, int], list[Told]]:
    groups: dict[tuple[str, int, int], list[Told]] = defaultdict(list)
    for told in found:
        groups[told.case[:3]].append(told)
    return groups


def after(told: Told, hours: float) -> float:
    """The best distance so far after so many lab hours; 441 (black to white) before the first."""
    seen = [best for at, best in zip(told.hours, told.best, strict=True) if at <= hours]
    return seen[-1] if seen else 441.0


def tables(found: Sequence[Told]) -> dict[str, str]:
    groups = group_by_case(found)
    batches = [("B", "rounds", "lab hours", "best distance", "after 1 h", "after 2 h")]
    for batch in BATCHES:
        group = groups[PAPER, batch, 1]
        early = [
            spread([after(told, hours) for told in group]) if all(t.hours[0] <= hours for t in group) else "–"
            for hours in (1, 2)
        ]
        ends, bests = [t.hours[-1] for t in group], [t.best[-1] for t in group]
        batches.append((str(batch), str(-(-SAMPLES // batch)), spread(ends), spread(bests), *early))
    solvers = [("solver", "best distance", "after 32 samples", "after 64 samples")]
    for solver in (PAPER, *OTHERS):
        group = groups[solver, COMPARED, 1]
        some = [spread([_after_samples(told, count) for told in group]) for count in (32, 64)]
        solvers.append((solver, spread([told.best[-1] for told in group]), *some))
    handlers = [("B", "OT-2s", "lab hours", "speed-up", "best distance")]
    for batch in MORE_BATCHES:
        alone = mean(told.hours[-1] for told in groups[PAPER, batch, 1])
        for count in (1, 2, 3):
            group = groups[PAPER, batch, count]
            ends = [told.hours[-1] for told in group]
            row = (
                str(batch),
                str(count),
                spread(ends),
                f"{alone / mean(ends):.2f} ×",
                spread([t.best[-1] for t in group]),
            )
            handlers.append(row)
    return {"batches": _table(batches), "solvers": _table(solvers), "handlers": _table(handlers)}


def _after_samples(told: Told, count: int) -> float:
    return [best for number, best in zip(told.samples, told.best, strict=True) if number <= count][-1]


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([head, "|" + " --- |" * len(rows[0]), *body])


def draw(found: Sequence[Told]) -> Figure:
    """The figure of the paper: best distance so far against elapsed lab time; lines are means over seeds,
    bands from the lowest to the highest."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots()
    groups = group_by_case(found)
    for number, batch in enumerate(BATCHES):
        group = groups[PAPER, batch, 1]
        first = max(told.hours[0] for told in group)
        hours = np.geomspace(first, mean(told.hours[-1] for told in group), 200)
        bests = np.array([[after(told, at) for at in hours] for told in group])
        axes.plot(hours, bests.mean(axis=0), color=f"C{number}", label=f"B = {batch}", drawstyle="steps-post")
        axes.fill_between(
            hours, bests.min(axis=0), bests.max(axis=0), color=f"C{number}", alpha=0.08, step="post"
        )
    axes.set(xlabel="elapsed lab time (h)", ylabel="best distance so far (RGB)", xscale="log", yscale="log")
    axes.set_title(
        f"{SAMPLES} samples, target {tuple(round(v) for v in TARGET)}, mean of {len(list(SEEDS))} seeds"
    )
    axes.legend(ncols=2)
    return figure


def write(found: Sequence[Told]) -> None:
    """The file, the figure, and the tables of the page between their marks."""
    rows = [
        {**told.case._asdict(), **{k: v for k, v in told._asdict().items() if k != "case"}} for told in found
    ]
    DATA.write_text("[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]\n", "utf-8")
    draw(found).savefig(PICTURE, dpi=100)
    page = PAGE.read_text("utf-8")
    for name, table in tables(found).items():
        before, mark, rest = page.partition(f"<!-- {name} -->\n")
        if not mark:
            raise SystemExit(f"{PAGE} has no mark <!-- {name} -->.")
        page = before + mark + table + "\n" + rest[rest.index("\n<!-- end -->") :]
    PAGE.write_text(page, "utf-8")


def read_results() -> list[Told]:
    """What the last study has found."""
    rows: list[dict[str, Any]] = json.loads(DATA.read_text("utf-8"))
    return [
        Told(
            Case(*(row[name] for name in Case._fields)), *(row[name] for name in ("hours", "samples", "best"))
        )
        for row in rows
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="The study of the color picker.")
    parser.add_argument("--draw", action="store_true", help="only draw what is in the file")
    parser.add_argument("--processes", type=int, default=2, help="how many experiments at once")
    parser.add_argument(
        "--part",
        type=Path,
        help="a file to which each experiment is added when it has ended; those in it are not done again",
    )
    given = parser.parse_args()
    if given.draw:
        write(read_results())
        return
    done: list[Told] = []
    if given.part and given.part.exists():
        for line in given.part.read_text().splitlines():
            case, *rest = json.loads(line)
            done.append(Told(Case(*case), *rest))
    left = sorted(
        set(cases()) - {told.case for told in done}, key=lambda c: (c.seed, -c.batch, c.handlers, c.solver)
    )
    with ProcessPoolExecutor(given.processes) as pool:
        for future in as_completed([pool.submit(carry_out, case) for case in left]):
            told = future.result()
            done.append(told)
            print(told.case, f"{told.hours[-1]:.2f} h, best {told.best[-1]:.2f}", flush=True)
            if given.part:
                with given.part.open("a") as file:
                    file.write(json.dumps(told) + "\n")
    write(sorted(done, key=lambda told: told.case))


if __name__ == "__main__":
    main()
