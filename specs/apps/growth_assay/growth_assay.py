"""Growth assay: how much of a drug halves the growth of bacteria.

The application of Vescovi et al., "Towards a Modular Architecture for Science Factories": for each plate a
workflow that makes and reads it (T0), twelve hours in the incubator, and a workflow that reads it again
(T12). Plates interleave: while one grows, the next are made.

    labos up rpl_growth --simulate --speed 2000 --home lab
    python specs/apps/growth_assay/growth_assay.py --home lab --user bo --plates 10
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from growth_analysis import BadReading, Curve, check, fit
from growth_layout import DRUG
from growth_plots import write_growth_report

from labos.client import Experiment, LabClient, RunResult
from labos.client.report import ReportPage, make_parser, run_program
from labos.errors import BadInput, LabosError

HERE = Path(__file__).resolve().parent

MOST_PLATES = 20
"""Of the first stacker of the incubator."""


class Outcome(NamedTuple):
    """What an assay has found; ``bad`` says of each plate that was left out why."""

    experiment: str
    curve: Curve
    plates: int
    bad: list[str]
    report: ReportPage


def assay(
    lab: LabClient, user: str, workcell: str, folder: Path, *, plates: int = 1, resume: str = ""
) -> Outcome:
    """Run the experiment and write its data; with ``resume``, it goes on where it was. However it ends, the
    lab throws away the plates that still grow. Raises BadReading if no plate can be used."""
    flows, slots = HERE / workcell, range(1, plates + 1)
    with Experiment(
        lab,
        "growth assay",
        user,
        closing=flows / "clear_incubator.yaml",
        closing_payload={"slots": list(slots)},
        workcell=workcell,
        resume=resume,
    ) as experiment:
        experiment.note("loop_started", "plates", plates=plates, drug=DRUG)
        made = [experiment.submit(flows / "create_plate.yaml", {"slot": slot}) for slot in slots]
        firsts, lasts = dict[str, RunResult](), dict[str, str]()
        for slot, run in zip(slots, made, strict=True):
            # Each is read twelve hours after its own incubation began; the next plates are made meanwhile.
            firsts[run] = _completed(lab, run)
            lasts[run] = experiment.submit(flows / "read_plate.yaml", {"slot": slot, "made_by": run})
        tables = [
            (run, firsts[run].result("Read T0"), _completed(lab, last).result("Read T12"))
            for run, last in lasts.items()
        ]
        experiment.note("loop_ended", "plates", plates=len(tables))
        good, bad = _sorted_out(experiment, tables)
        if not good:
            raise BadReading(
                f"No plate can be used. {' '.join(bad)}", remedy="Look at the tables in the log."
            )
        first, last_ = [pair[0] for pair in good], [pair[1] for pair in good]
        curve = fit(first, last_)
        experiment.note("local_compute", "dose-response curve", plates=len(good), **curve._asdict())
        data = json.dumps({"T0": first, "T12": last_, "curve": curve._asdict()}, indent=1)
        report = write_growth_report(experiment, folder / experiment.id, first, last_, curve)
        (folder / experiment.id / "readings.json").write_text(data, "utf-8")
    return Outcome(experiment.id, curve, len(good), bad, report)


def _completed(lab: LabClient, run: str) -> RunResult:
    """The run at its end. Raises LabosError if it did not complete."""
    result = lab.wait(run)
    if not result.succeeded:
        raise LabosError(f"Run {run} ({result.workflow}) {result.status}: {result.why or 'no reason'}.")
    return result


def _sorted_out(
    experiment: Experiment, tables: Sequence[tuple[str, Any, Any]]
) -> tuple[list[tuple[dict[str, float], dict[str, float]]], list[str]]:
    """The readings of plates that can be used, and what is wrong with the others: an experiment error in the
    log, with the table."""
    good, bad = [], []
    for run, first, last in tables:
        try:
            good.append((check(first, f"{run} at T0"), check(last, f"{run} at T12")))
        except BadReading as error:
            bad.append(error.message)
            experiment.note(
                "condition_checked",
                "readings can be used",
                met=False,
                error="experiment",
                why=error.message,
                tables={"T0": first, "T12": last},
            )
    return good, bad


def prepare(given: argparse.Namespace) -> Callable[[LabClient], list[str]]:
    if not 1 <= given.plates <= MOST_PLATES:
        raise BadInput(f"--plates is {given.plates}.", remedy=f"Give 1 to {MOST_PLATES}.")

    def work(lab: LabClient) -> list[str]:
        folder, options = given.out or Path("growth"), {"plates": given.plates, "resume": given.resume}
        found = assay(lab, given.user, given.workcell, folder, **options)
        ic50, error = found.curve.ic50, found.curve.ic50_error
        return [
            *(f"left out: {why}" for why in found.bad),
            f"IC50 {ic50:.3f} ± {error:.3f} mg/L of {DRUG}, from {found.plates} plates.",
            found.report.line,
        ]

    return work


def main() -> int:
    parser = make_parser("Find how much of a drug halves the growth of bacteria.", user="bo", out="growth")
    parser.add_argument("--workcell", choices=("rpl", "bio"), default="rpl", help="where it runs")
    parser.add_argument("--plates", type=int, default=1, help=f"how many, {MOST_PLATES} at the most")
    return run_program("growth assay", parser, prepare)


if __name__ == "__main__":
    sys.exit(main())
