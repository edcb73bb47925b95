"""Electrochromic polymers: finds the monomers and the chain length of a polymer of a wanted colour.

The application of Vescovi et al., "Towards a Modular Architecture for Science Factories": a synthesis
platform makes a batch of polymers on a plate, an arm carries it to a reader and back, spectra become colours,
and a model proposes the next batch.

    python specs/apps/polymers/polymers.py --home lab --user ada
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polymer_colours import Lab, Spectra, chromaticity_of, difference, judge, lab_of, read_table
from polymer_recommender import Recipe, Recommender
from polymer_report import Sample, write_polymer_report

from labos.client import Experiment, LabClient
from labos.client.report import make_parser, read_payload, run_program
from labos.errors import BadInput, LabosError

HERE = Path(__file__).resolve().parent
FLOWS = HERE / "workflows"
PLATE_WELLS = 96
THINNER = 0.6


@dataclass
class Wanted:
    """What the payload file says."""

    target: Lab
    tolerance: float = 1.0
    batches: int = 10
    wells: int = 6
    monomers_ul: float = 60.0
    step_nm: float = 10.0
    measure_again: int = 2
    saturated: str = "ask"

    def __post_init__(self) -> None:
        self.target = tuple(float(value) for value in self.target)  # type: ignore[assignment]
        if len(self.target) != 3:
            raise BadInput("`target` needs three numbers.", remedy="Give L*, a* and b*.")
        if self.wells * self.batches > PLATE_WELLS:
            raise BadInput(
                f"{self.batches} batches of {self.wells} wells are more than a plate has.",
                remedy=f"Ask for {PLATE_WELLS} wells at the most.",
            )
        if self.saturated not in ("ask", "thinner"):
            raise BadInput(f"`saturated: {self.saturated}` is unknown.", remedy="Write ask or thinner.")


def read_wanted(path: Path) -> Wanted:
    """A payload file. Raises BadInput."""
    told = read_payload(path, Wanted, {"target": "Write `target: [44, 12, -55]`."})
    try:
        return Wanted(**told)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{path}: {error}.") from None


class Search:
    """One experiment, from a fresh plate to the finished one."""

    def __init__(self, lab: LabClient, experiment: Experiment, wanted: Wanted, seed: int) -> None:
        self.lab, self.experiment, self.wanted = lab, experiment, wanted
        self.recommender = Recommender(wanted.target, difference, seed)
        self.samples: list[Sample] = []
        self.monomers_ul = wanted.monomers_ul

    def run(self) -> None:
        wanted, experiment = self.wanted, self.experiment
        experiment.run(FLOWS / "new_plate.yaml")
        experiment.note(
            "loop_started", "make, measure and learn", batches=wanted.batches, target=wanted.target
        )
        for number in range(wanted.batches):
            self._batch(number)
            nearest = self.recommender.nearest
            met = nearest <= wanted.tolerance
            shown = nearest if self.samples else None
            experiment.note(
                "condition_checked", "near enough", nearest=shown, limit=wanted.tolerance, met=met
            )
            if met:
                break
        experiment.note("loop_ended", "make, measure and learn", samples=len(self.samples))
        experiment.run(FLOWS / "plate_done.yaml")

    def _batch(self, number: int) -> None:
        wells = well_names(number * self.wanted.wells, self.wanted.wells)
        proposed = self.recommender.ask(len(wells))
        decided = self.experiment.decide("next batch", lambda: dict(zip(wells, proposed, strict=True)))
        recipes = [Recipe(*decided[well]) for well in wells]
        result = self.experiment.run(FLOWS / "make_and_measure.yaml", self._payload(number, wells, recipes))
        table = result.result("Measure spectra")
        spectra = read_table(self.lab.file(table))
        good = self._good_wells(number, wells, spectra, table)
        made = dict(zip(wells, recipes, strict=True))
        fresh = [self._sample(number, well, made[well], spectra) for well in good]
        self.experiment.note(
            "local_compute",
            "colours of the wells",
            table=table,
            colours={sample.well: sample.lab for sample in fresh},
            differences={sample.well: sample.difference for sample in fresh},
        )
        self.samples += fresh
        self.recommender.tell([sample.recipe for sample in fresh], [sample.lab for sample in fresh])

    def _payload(self, number: int, wells: list[str], recipes: list[Recipe]) -> dict[str, Any]:
        doses = {
            f"monomer_{name}_volumes": [round(recipe[index] * self.monomers_ul, 2) for recipe in recipes]
            for index, name in enumerate("ABC")
        }
        lengths = [recipe.length for recipe in recipes]
        more = {"wells": wells, "chain_lengths": lengths, "batch": number, "step": self.wanted.step_nm}
        return {**doses, **more}

    def _good_wells(self, number: int, wells: list[str], spectra: Spectra, table: Any) -> list[str]:
        """Wells whose spectra can be used. Those without numbers are measured again; of saturated ones a
        person is asked, or the next batch is made thinner. What stays bad is left out."""
        judged = judge(spectra, wells)
        for again in range(self.wanted.measure_again):
            if not judged.no_number:
                break
            self._tell_error(
                "no number in a spectrum", judged.no_number, table, f"measured again ({again + 1})"
            )
            result = self.experiment.run(
                FLOWS / "measure_again.yaml", {"batch": number, "step": self.wanted.step_nm}
            )
            table = result.result("Measure spectra")
            told = read_table(self.lab.file(table))
            spectra.od.update({well: told.od[well] for well in judged.no_number if well in told.od})
            judged = judge(spectra, wells)
        if judged.no_number:
            self._tell_error("no number in a spectrum", judged.no_number, table, "left out")
        if judged.saturated:
            self._handle_saturated(judged.saturated, table)
        return judged.good

    def _handle_saturated(self, wells: list[str], table: Any) -> None:
        self._tell_error("saturated spectrum", wells, table, self.wanted.saturated)
        if self.wanted.saturated == "ask":
            words = (
                f"Spectra of {', '.join(wells)} are saturated: look at the plate and at the stock solutions."
            )
            self.experiment.run(FLOWS / "ask.yaml", {"instruction": words})
        self.monomers_ul *= THINNER

    def _tell_error(self, what: str, wells: list[str], table: Any, then: str) -> None:
        """An experiment error: the result is out of range. The table is named by its digest."""
        self.experiment.note(
            "condition_checked", what, met=False, error="experiment", wells=wells, table=table, then=then
        )

    def _sample(self, number: int, well: str, recipe: Recipe, spectra: Spectra) -> Sample:
        nm, od = spectra.nm, spectra.od[well]
        lab = lab_of(nm, od)
        apart = difference(lab, self.wanted.target)
        return Sample(number, well, recipe, lab, chromaticity_of(nm, od), apart, nm, od)


def well_names(first: int, count: int) -> list[str]:
    """A1, A2 … H12, row by row."""
    return [f"{'ABCDEFGH'[well // 12]}{well % 12 + 1}" for well in range(first, first + count)]


def find_polymer(
    lab: LabClient,
    user: str,
    wanted: Wanted,
    *,
    seed: int = 0,
    out: Path | None = None,
    resume: str = "",
) -> str:
    """Run the experiment and write its report; returns what was found and where the data is. With ``resume``,
    the experiment goes on where it was."""
    with Experiment(
        lab,
        "electrochromic polymers",
        user,
        closing=FLOWS / "plate_done.yaml",
        workcell="cnm",
        parking=["chemspeed.default"],
        resume=resume,
    ) as experiment:
        search = Search(lab, experiment, wanted, seed)
        search.run()
        if not search.samples:
            raise LabosError(
                f"No spectrum of {experiment.id} could be used.", remedy="Look at its tables in the log."
            )
        report = write_polymer_report(experiment, out, search.samples, wanted.target, wanted.tolerance)
    nearest = search.recommender.nearest
    verdict = "found" if nearest <= wanted.tolerance else "not found"
    return (
        f"{verdict}: a difference of {nearest:.2f} (CIE 2000) to the target "
        f"after {len(search.samples)} samples. {report.line}"
    )


def prepare(given: Namespace) -> Callable[[LabClient], list[str]]:
    wanted = read_wanted(given.payload)
    options = {"seed": given.seed, "out": given.out, "resume": given.resume}
    return lambda lab: [find_polymer(lab, given.user, wanted, **options)]


def main() -> int:
    parser = make_parser("Find a polymer of a wanted colour.", user="ada", out="polymers-EXPERIMENT")
    parser.add_argument(
        "--payload", type=Path, default=HERE / "payloads" / "blue.yaml", help="what is wanted"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the recommender")
    return run_program("polymers", parser, prepare)


if __name__ == "__main__":
    sys.exit(main())
