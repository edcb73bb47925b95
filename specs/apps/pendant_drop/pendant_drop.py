"""Pendant drop: measures how fast particles diffuse in a drop that hangs from a robot's pipette.

The application of Vescovi et al., "Towards a Modular Architecture for Science Factories": one workflow of an
arm with a pipette on a tool changer, at a beamline whose detector takes a series of speckle. The series
becomes a diffusion coefficient, and a radius by Stokes and Einstein.

    python specs/apps/pendant_drop/pendant_drop.py --home lab --user qi
"""

from __future__ import annotations

import io
import sys
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from drop_dynamics import BadSeries, find_dynamics, series_of
from drop_report import Drop, Summary, summary_of, write_drop_report

from labos.client import Experiment, LabClient
from labos.client.report import make_parser, read_payload, run_program
from labos.errors import BadInput, LabosError

HERE = Path(__file__).resolve().parent
FLOWS = HERE / "workflows"
LESS_LIGHT = 1 / 3


@dataclass
class Wanted:
    """What the payload file says."""

    liquid_1: str
    liquid_2: str
    viscosity: float
    wells: list[str] = field(default_factory=lambda: ["A1"])
    frames: int = 256
    period: float = 2e-5
    transmission: float = 0.1
    again: int = 3
    no_drop: str = "again"

    def __post_init__(self) -> None:
        if not self.viscosity > 0:
            raise BadInput("`viscosity` must be above 0.", remedy="Give it in Pa s: 0.00089 for water.")
        if not self.wells:
            raise BadInput("`wells` is empty.", remedy="Name a well: [A1].")
        if self.no_drop not in ("again", "ask"):
            raise BadInput(f"`no_drop: {self.no_drop}` is unknown.", remedy="Write again or ask.")


def read_wanted(path: Path) -> Wanted:
    """A payload file. Raises BadInput."""
    told = read_payload(path, Wanted)
    try:
        return Wanted(**told)
    except TypeError as error:
        raise BadInput(f"{path}: {error}.") from None


class Measurement:
    """One experiment: a drop from each well."""

    def __init__(self, lab: LabClient, experiment: Experiment, wanted: Wanted) -> None:
        self.lab, self.experiment, self.wanted = lab, experiment, wanted
        self.transmission = wanted.transmission
        self.drops: list[Drop] = []

    def run(self) -> None:
        wells = self.wanted.wells
        self.experiment.note("loop_started", "drops", wells=wells)
        for well in wells:
            drop = self._measure(well)
            if drop is not None:
                self.drops.append(drop)
        self.experiment.note("loop_ended", "drops", measured=[drop.well for drop in self.drops])

    def _measure(self, well: str) -> Drop | None:
        """A drop from a well; again, if it gave no good series. None if none did."""
        for _ in range(1 + self.wanted.again):
            told = self._run(well)
            try:
                drop = self._look(well, told)
            except BadSeries as bad:
                self._handle(str(bad), well, told)
                continue
            found = drop.dynamics
            self.experiment.note(
                "local_compute",
                "diffusion coefficient",
                well=well,
                series=told["series"],
                diffusion=found.diffusion,
                error=found.error,
                rates=[curve.rate for curve in found.curves],
            )
            return drop
        return None

    def _run(self, well: str) -> dict[str, Any]:
        wanted = self.wanted
        payload = {
            "well": well,
            "liquid_1": wanted.liquid_1,
            "liquid_2": wanted.liquid_2,
            "frames": wanted.frames,
            "period": wanted.period,
            "transmission": self.transmission,
        }
        result = self.experiment.run(FLOWS / "pendant_drop.yaml", payload)
        told: dict[str, Any] = result.result("Take series")
        return told

    def _look(self, well: str, told: dict[str, Any]) -> Drop:
        """What a series tells. Raises BadSeries."""
        if told["drop"] not in ("Yes", 1):
            raise BadSeries("no drop seen")
        content, picture = self._array(told["series"]), self._array(told["microscope"])
        found = self.experiment.compute(find_dynamics, told, content)
        if isinstance(found, str):
            raise BadSeries(found)
        series, side = series_of(told, content), int(np.sqrt(picture.size))
        return Drop(well, found, series.temperature, series.counts[0], picture.reshape(side, side))

    def _array(self, file: Any) -> np.ndarray:
        try:
            return np.load(io.BytesIO(self.lab.file(file)), allow_pickle=False)
        except ValueError as error:
            raise BadSeries("unreadable series") from error

    def _handle(self, what: str, well: str, told: dict[str, Any]) -> None:
        """An experiment error: the result is out of range. Picture and series are named by their digests."""
        then = "again"
        if what == "saturated series":
            self.transmission *= LESS_LIGHT
            then = f"again with a transmission of {self.transmission:.3g}"
        elif what == "no drop seen" and self.wanted.no_drop == "ask":
            then = "a person is asked"
        files = {name: told.get(name) for name in ("microscope", "series")}
        self.experiment.note(
            "condition_checked", what, met=False, error="experiment", well=well, then=then, **files
        )
        if then == "a person is asked":
            words = f"No drop was seen from well {well}: look at the tip and at the well."
            self.experiment.run(FLOWS / "ask.yaml", {"instruction": words})


def measure_diffusion(
    lab: LabClient, user: str, wanted: Wanted, *, out: Path | None = None, resume: str = ""
) -> tuple[Summary, str]:
    """Run the experiment and write its report; returns what was found, and a line about it that says where
    the data is. With ``resume``, the experiment goes on where it was."""
    with Experiment(lab, "pendant drop", user, workcell="aps_8id", resume=resume) as experiment:
        experiment.configure_compute(pool=1)
        measurement = Measurement(lab, experiment, wanted)
        measurement.run()
        if not measurement.drops:
            raise LabosError(
                f"No drop of {experiment.id} gave a series that could be used.",
                remedy="Look at its pictures in the log.",
            )
        report = write_drop_report(experiment, out, measurement.drops, wanted.viscosity)
    found = summary_of(measurement.drops, wanted.viscosity)
    return found, (
        f"D = {found.diffusion * 1e12:.3f} ± {found.error * 1e12:.3f} µm²/s, "
        f"a radius of {found.radius * 1e9:.1f} nm, "
        f"from {len(measurement.drops)} of {len(wanted.wells)} drops. {report.line}"
    )


def prepare(given: Namespace) -> Callable[[LabClient], list[str]]:
    wanted = read_wanted(given.payload)
    return lambda lab: [measure_diffusion(lab, given.user, wanted, out=given.out, resume=given.resume)[1]]


def main() -> int:
    parser = make_parser(
        "Measure how fast particles diffuse in a pendant drop.", user="qi", out="drops-EXPERIMENT"
    )
    parser.add_argument(
        "--payload", type=Path, default=HERE / "payloads" / "silica_50.yaml", help="what is measured"
    )
    return run_program("pendant drop", parser, prepare)


if __name__ == "__main__":
    sys.exit(main())
