"""Color picker: finds the amounts of three dyes that make a wanted colour.

The application of Vescovi et al., "Towards a Modular Architecture for Science Factories": a fresh plate;
then, in a loop, a solver proposes a batch of mixtures, a liquid handler mixes them in wells, a camera
photographs the plate, and the colours in the picture are told to the solver; at the end the plate goes into
the trash.
Several liquid handlers may share each batch.

    labos up rpl_picker --simulate --speed 1000 --home lab
    python specs/apps/color_picker/color_picker.py --home lab --user bo
"""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from color_report import Sample, write_picker_report
from color_solvers import Mixture, distance, solver_of

from labos.client import Experiment, LabClient, RunFailed, RunResult
from labos.client.plate_reading import BadPicture, Color, Reading, read_plate
from labos.client.report import make_parser, read_payload, run_program
from labos.errors import BadInput, LabosError

HERE = Path(__file__).resolve().parent
FLOWS = HERE / "workflows"
WELLS = [f"{row}{column}" for row in "ABCDEFGH" for column in range(1, 13)]
PARKING = ("wc.parking", "wc.parking2", "wc.parking3")
"""Where the plate of the first, second and third liquid handler waits."""

Work = Generator[tuple[str, dict[str, Any]], RunResult, list[Sample]]
"""What one liquid handler has to do: yields workflows with their payloads, and is sent how they ended."""


@dataclass
class Wanted:
    """What the payload file says."""

    target: Color
    samples: int = 128
    batch: int = 8
    close: float = 2.0
    solver: str = "evolutionary"
    handlers: list[str] = field(default_factory=lambda: ["ot2_cp_gamma"])
    photograph_again: int = 2
    bad_pictures: str = "ask"

    def __post_init__(self) -> None:
        self.target = tuple(float(value) for value in self.target)  # type: ignore[assignment]
        if len(self.target) != 3 or not all(0 <= value <= 255 for value in self.target):
            raise BadInput("`target` is no colour.", remedy="Give red, green and blue, 0 to 255 each.")
        if self.batch < 1 or self.samples < 1:
            raise BadInput("`samples` and `batch` must be 1 at least.", remedy="Give whole numbers.")
        if not 1 <= len(self.handlers) <= len(PARKING):
            raise BadInput("`handlers` names none, or too many.", remedy=f"Name one to {len(PARKING)}.")
        if self.bad_pictures not in ("ask", "leave_out"):
            raise BadInput(
                f"`bad_pictures: {self.bad_pictures}` is unknown.", remedy="Write ask or leave_out."
            )


def read_wanted(path: Path) -> Wanted:
    """A payload file. Raises BadInput."""
    told = read_payload(path, Wanted, {"target": "Write `target: [120, 120, 120]`."})
    try:
        return Wanted(**told)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{path}: {error}.") from None


def parkings_of(wanted: Wanted) -> list[str]:
    """Where the plates wait, one for each liquid handler."""
    return list(PARKING[: len(wanted.handlers)])


class Lane:
    """A liquid handler with the plate that belongs to it."""

    def __init__(self, search: Search, handler: str, parking: str) -> None:
        self.search, self.handler, self.parking = search, handler, parking
        self._used: int | None = None
        """Wells of the present plate that are filled; None without a plate."""
        self._tips_begun = False
        self._submitted = 0

    def submit(self, flow: str, payload: dict[str, Any]) -> str:
        """Its next run, by a key of its own: another liquid handler may be quicker another time."""
        self._submitted += 1
        key = f"{self.handler} {self._submitted}"
        return self.search.experiment.submit(FLOWS / f"{flow}.yaml", payload, key=key)

    def work(self, mixtures: Sequence[Mixture]) -> Work:
        """Mix, photograph and read; a full plate is replaced by a fresh one."""
        found: list[Sample] = []
        while mixtures:
            if self._used is None or self._used == len(WELLS):
                yield from self._replace_plate()
            assert self._used is not None
            now, mixtures = mixtures[: len(WELLS) - self._used], mixtures[len(WELLS) - self._used :]
            found += yield from self._mix(now)
        return found

    def throw_away(self) -> Work:
        if self._used is not None:
            yield "trash_plate", {"parking": self.parking}
        self._used = None
        return []

    def _replace_plate(self) -> Work:
        yield from self.throw_away()
        yield "new_plate", {"parking": self.parking}
        self._used = 0
        return []

    def _mix(self, mixtures: Sequence[Mixture]) -> Work:
        assert self._used is not None
        wells = WELLS[self._used : self._used + len(mixtures)]
        volumes = {f"color_{name}_volumes": [m[n] for m in mixtures] for n, name in enumerate("ABC")}
        result = yield (
            "mix_and_photograph",
            {
                "handler": self.handler,
                "deck": f"{self.handler}.deck2",
                "parking": self.parking,
                "destination_wells": wells,
                "use_existing_resources": self._tips_begun,
                **volumes,
            },
        )
        self._used += len(wells)
        self._tips_begun = True
        mixed_at = result.ended_at
        asks = self.search.wanted.bad_pictures == "ask"
        then = ["photograph again"] * self.search.wanted.photograph_again
        then += ["a person is asked", "left out"] if asks else ["left out"]
        reading = self.search.read(result, wells, then[0])
        for before, after in pairwise(then):
            if reading is not None:
                break
            if before == "a person is asked":
                words = f"No good picture of the plate at {self.parking}: look at camera, lamp and nest."
                yield "ask", {"instruction": words}
            again = yield "photograph_again", {"parking": self.parking}
            reading = self.search.read(again, wells, after)
        if reading is None:
            return []
        pairs = zip(wells, mixtures, strict=True)
        return [self.search.sample(well, mixture, reading.colors[well], mixed_at) for well, mixture in pairs]


class Search:
    """From the first plate to the last."""

    def __init__(self, lab: LabClient, experiment: Experiment, wanted: Wanted, seed: int) -> None:
        self.lab, self.experiment, self.wanted = lab, experiment, wanted
        self.solver = solver_of(wanted.solver, wanted.target, seed)
        self.lanes = [Lane(self, *lane) for lane in zip(wanted.handlers, parkings_of(wanted), strict=True)]
        self.samples: list[Sample] = []
        self.tried = 0
        self.last_picture: Any = None

    @property
    def nearest(self) -> float:
        return min((sample.distance for sample in self.samples), default=float("inf"))

    def run(self) -> None:
        wanted, note = self.wanted, self.experiment.note
        note(
            "loop_started",
            "mix, look and learn",
            target=wanted.target,
            solver=wanted.solver,
            batch=wanted.batch,
        )
        while self.tried < wanted.samples:
            self._batch(min(wanted.batch, wanted.samples - self.tried))
            met = self.nearest <= wanted.close
            near = self.nearest if self.samples else None
            note("condition_checked", "near enough", nearest=near, limit=wanted.close, met=met)
            if met:
                break
        note("loop_ended", "mix, look and learn", samples=len(self.samples))
        self._carry_out([(lane, lane.throw_away()) for lane in self.lanes])

    def _batch(self, count: int) -> None:
        proposed = self.solver.ask(count)
        decided = self.experiment.decide("next mixtures", lambda: proposed)
        mixtures = [Mixture(*amounts) for amounts in decided]
        share = -(-count // len(self.lanes))
        parts = [mixtures[n * share : (n + 1) * share] for n in range(len(self.lanes))]
        fresh = self._carry_out(
            [(lane, lane.work(part)) for lane, part in zip(self.lanes, parts, strict=True) if part]
        )
        self.tried += count
        self.samples += fresh
        self.solver.tell([sample.mixture for sample in fresh], [sample.color for sample in fresh])
        self._publish(fresh)

    def _carry_out(self, works: Sequence[tuple[Lane, Work]]) -> list[Sample]:
        """All at once, each run after the one before it; samples in the order of ``works``, whichever ends
        first. Raises RunFailed."""
        found: dict[Lane, list[Sample]] = {lane: [] for lane, _ in works}
        waiting: dict[str, tuple[Lane, Work]] = {}

        def go_on(lane: Lane, work: Work, ended: RunResult | None) -> None:
            try:
                flow, payload = next(work) if ended is None else work.send(ended)
            except StopIteration as done:
                found[lane] = done.value
                return
            waiting[lane.submit(flow, payload)] = lane, work

        for lane, work in works:
            go_on(lane, work, None)
        while waiting:
            ended = next(iter(self.lab.as_completed(list(waiting))))
            if not ended.succeeded:
                raise RunFailed(ended)
            go_on(*waiting.pop(ended.id), ended)
        return [sample for samples in found.values() for sample in samples]

    def read(self, result: RunResult, wells: Sequence[str], then: str) -> Reading | None:
        """The colours in a run's picture; None, and an experiment error in the log with the picture and what
        is done ``then``, if it cannot be used."""
        picture = result.result("Take picture")
        try:
            reading = read_plate(self.lab.file(picture), wells)
        except BadPicture as bad:
            self.experiment.note(
                "condition_checked",
                "the picture can be used",
                met=False,
                error="experiment",
                why=bad.kind,
                message=bad.message,
                picture=picture,
                then=then,
            )
            return None
        self.last_picture = picture
        self.experiment.note("local_compute", "colors of the wells", picture=picture, colors=reading.colors)
        return reading

    def sample(self, well: str, mixture: Mixture, color: Color, mixed_at: int) -> Sample:
        return Sample(well, mixture, color, distance(color, self.wanted.target), mixed_at)

    def _publish(self, fresh: Sequence[Sample]) -> None:
        """The samples of this round as a file of the lab."""
        content = json.dumps([sample._asdict() for sample in fresh], default=str).encode()
        self.experiment.note(
            "publication", "samples", file=self.experiment.keep_file(content), count=len(fresh)
        )


def pick_color(
    lab: LabClient,
    user: str,
    wanted: Wanted,
    *,
    workcell: str = "rpl_picker",
    seed: int = 0,
    out: Path | None = None,
    resume: str = "",
) -> str:
    """Run the experiment and write its report; returns what was found and where the data is. With ``resume``,
    it goes on where it was."""
    parkings = parkings_of(wanted)
    with Experiment(
        lab,
        "color picker",
        user,
        closing=FLOWS / "trash_plates.yaml",
        closing_payload={"parkings": parkings},
        workcell=workcell,
        parking=parkings,
        resume=resume,
    ) as experiment:
        search = Search(lab, experiment, wanted, seed)
        search.run()
        if not search.samples:
            raise LabosError(
                f"No picture of {experiment.id} could be used.", remedy="Look at them in the log."
            )
        picture = lab.file(search.last_picture)
        report = write_picker_report(experiment, out, search.samples, wanted.target, picture)
    verdict = "found" if search.nearest <= wanted.close else "not found"
    told = f"a distance of {search.nearest:.2f} to the target after {len(search.samples)} samples"
    return f"{verdict}: {told}. {report.line}"


def prepare(given: Namespace) -> Callable[[LabClient], list[str]]:
    wanted = read_wanted(given.payload)
    options = {"workcell": given.workcell, "seed": given.seed, "out": given.out, "resume": given.resume}
    return lambda lab: [pick_color(lab, given.user, wanted, **options)]


def main() -> int:
    parser = make_parser(
        "Find the amounts of three dyes that make a wanted colour.", user="bo", out="color-EXPERIMENT"
    )
    parser.add_argument(
        "--payload", type=Path, default=HERE / "payloads" / "grey.yaml", help="what is wanted"
    )
    parser.add_argument("--workcell", default="rpl_picker", help="where it runs")
    parser.add_argument("--seed", type=int, default=0, help="of the solver")
    return run_program("color picker", parser, prepare)


if __name__ == "__main__":
    sys.exit(main())

__all__ = ["RunFailed", "Search", "Wanted", "main", "pick_color", "read_wanted"]
