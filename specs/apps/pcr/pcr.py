"""Polymerase chain reaction: prepare, seal, cycle, peel and photograph plates.

The application of Vescovi et al., "Towards a Modular Architecture for Science Factories": one workflow, which
is LabOS' own ``pcr`` (finished plates wait in a hotel for a person), or with ``--published`` the one of SI
A.2 as it was published (plates end in the trash).

    labos up rpl --simulate --speed 1000 --home lab
    python specs/apps/pcr/pcr.py --home lab --user ada
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from labos.client import Experiment, LabClient, RunFailed, RunResult
from labos.client.plate_reading import BadPicture, read_plate
from labos.client.report import make_parser, read_payload, run_program
from labos.client.report import write_report as write_page
from labos.errors import BadInput

HERE = Path(__file__).resolve().parent
PUBLISHED = HERE / "published" / "pcr_demo_wf.yaml"
PICTURES = {False: "Take picture", True: "camera takes picture of plate"}
CYCLES = {False: "Cycle", True: "Run biometra program"}
PROGRAM = 3
"""Which program of the cycler both workflows start."""
STEP_WORDS = {"name", "temperature_c", "time_s", "cycle"}


@dataclass
class Programme:
    """What the cycler does under a number: steps with temperatures (°C) and times (s, 0 for as long as the
    plate stays); those with ``cycle`` are repeated."""

    steps: list[dict[str, Any]]
    cycles: int = 1
    lid_c: float = 99.0

    def course(self) -> list[tuple[float, float]]:
        """Times (min) and temperatures, without ramps."""
        cycle = [step for step in self.steps if step.get("cycle")]
        first = self.steps.index(cycle[0]) if cycle else len(self.steps)
        after = [step for step in self.steps[first:] if not step.get("cycle")]
        at, points = 0.0, list[tuple[float, float]]()
        for step in [*self.steps[:first], *cycle * self.cycles, *after]:
            points.append((at / 60, float(step["temperature_c"])))
            at += float(step["time_s"])
            points.append((at / 60, float(step["temperature_c"])))
        return points


@dataclass
class Wanted:
    """What the payload file says."""

    programme: Programme
    program: int = 3
    seal_s: float = 3.0
    plates: int = field(default=1)

    def __post_init__(self) -> None:
        if self.program != PROGRAM:
            raise BadInput(
                f"`program` is {self.program}, but the workflows start program {PROGRAM}.",
                remedy="Store the programme in the cycler under that number.",
            )
        if self.plates < 1:
            raise BadInput("`plates` must be 1 at least.", remedy="Give a whole number.")


def read_wanted(path: Path) -> Wanted:
    """A payload file. Raises BadInput."""
    remedy = "Say what the cycler does: see standard.yaml."
    told = read_payload(path, Wanted, {"programme": remedy})
    if not isinstance(told["programme"], dict):
        raise BadInput(f"{path}: `programme` is no table.", remedy=remedy)
    try:
        programme = Programme(**told["programme"])
        for step in programme.steps:
            if set(step) - STEP_WORDS or not {"temperature_c", "time_s"} <= set(step):
                raise BadInput(
                    f"{path}: {step} is no step of a programme.",
                    remedy="Give `name`, `temperature_c`, `time_s` and, if it is repeated, `cycle: true`.",
                )
        programme.course()
        return Wanted(**{**told, "programme": programme})
    except (TypeError, ValueError) as error:
        raise BadInput(f"{path}: {error}.") from None


def run_pcr(
    lab: LabClient,
    user: str,
    wanted: Wanted,
    *,
    published: bool = False,
    workcell: str = "rpl",
    out: Path | None = None,
    resume: str = "",
) -> str:
    """Run so many plates, and write the report; returns what became of them and where the data is. With
    ``resume``, the experiment goes on where it was."""
    programme = wanted.programme
    flow = PUBLISHED if published else "pcr"
    with Experiment(lab, "pcr", user, workcell=workcell, resume=resume) as experiment:
        experiment.note(
            "decision",
            "thermal programme",
            program=wanted.program,
            cycles=programme.cycles,
            lid_c=programme.lid_c,
            steps=programme.steps,
        )
        runs = experiment.submit_all(flow, [{"seal": {"time": wanted.seal_s}}] * wanted.plates)
        results = {result.id: result for result in experiment.as_completed(runs)}
        done = [results[run] for run in runs]
        pictures = {
            f"plate{number}.jpg": _picture(lab, result, published) for number, result in enumerate(done, 1)
        }
        bad = [result.id for result in done if not _can_be_used(lab, experiment, result, published)]
        report = write_page(
            experiment,
            out or Path(f"pcr-{experiment.id}"),
            "PCR",
            paragraphs=[
                f"{len(done)} plates, program {wanted.program} of the cycler: {programme.cycles} cycles, "
                f"lid at {programme.lid_c:g} °C.",
                *([f"Pictures that do not show the plate well: {', '.join(bad)}."] if bad else []),
            ],
            pictures={
                "programme.png": ("the thermal programme, without ramps", draw_programme(programme)),
                **{name: ("a plate at the end", content) for name, content in pictures.items()},
            },
            table=[_row(result, published) for result in done],
            files="pictures",
        )
    where = "are in the trash" if published else "wait in the output hotel"
    look = f" Look at the plates of {', '.join(bad)}: their pictures are bad." if bad else ""
    return f"{len(done)} plates are done and {where}.{look} {report.line}"


def _picture(lab: LabClient, result: RunResult, published: bool) -> bytes:
    return lab.file(result.result(PICTURES[published]))


def _can_be_used(lab: LabClient, experiment: Experiment, result: RunResult, published: bool) -> bool:
    """Whether the picture shows the plate in its nest. If not, that is an experiment error in the log, with
    the picture; the plate is done all the same, and who fetches it is told to look."""
    try:
        read_plate(_picture(lab, result, published), [])
    except BadPicture as bad:
        experiment.note(
            "condition_checked",
            "the picture can be used",
            met=False,
            error="experiment",
            why=bad.kind,
            message=bad.message,
            picture=result.result(PICTURES[published]),
            then="a person looks at the plate",
        )
        return False
    return True


def _row(result: RunResult, published: bool) -> dict[str, Any]:
    """When the plate was cycled, as the log has it (UTC nanoseconds)."""
    step = next(step for step in result.steps if step.key == CYCLES[published])
    return {"run": result.id, "cycling_from": step.requested_at, "cycling_until": step.ended_at}


def draw_programme(programme: Programme) -> Figure:
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    minutes, celsius = zip(*programme.course(), strict=True)
    axes.plot(minutes, celsius, color="#b5482a", linewidth=1)
    axes.set(xlabel="time (min)", ylabel="block (°C)", title=f"{programme.cycles} cycles")
    return figure


def prepare(given: Namespace) -> Callable[[LabClient], list[str]]:
    wanted = read_wanted(given.payload)
    options = {"published": given.published, "workcell": given.workcell, "out": given.out}
    return lambda lab: [run_pcr(lab, given.user, wanted, **options, resume=given.resume)]


def main() -> int:
    parser = make_parser(
        "Prepare, seal, cycle, peel and photograph plates.", user="ada", out="pcr-EXPERIMENT"
    )
    parser.add_argument(
        "--payload", type=Path, default=HERE / "payloads" / "standard.yaml", help="programme and plates"
    )
    parser.add_argument(
        "--published", action="store_true", help="the workflow of the paper's SI A.2 as it is"
    )
    parser.add_argument("--workcell", default="rpl", help="where it runs")
    return run_program("pcr", parser, prepare)


if __name__ == "__main__":
    sys.exit(main())

__all__ = ["RunFailed", "Wanted", "main", "read_wanted", "run_pcr"]
