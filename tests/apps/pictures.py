"""Draws the pictures of the applications' pages anew: ``python -m tests.apps.pictures``."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from labos.spec.library import find_specs_folder

APPS = find_specs_folder() / "apps"
BLUE = (44.0, 12.0, -55.0)
GREY = (120.0, 120.0, 120.0)


def draw_polymers() -> Figure:
    """The way to a deep blue, of a simulated platform and reader."""
    from polymer_colours import chromaticity_of, difference, lab_of
    from polymer_recommender import Recommender
    from polymer_report import Sample, draw_convergence
    from polymers import well_names

    from tests.apps.simulated import Platform

    platform, recommender = Platform(), Recommender(BLUE, difference, 0)
    samples: list[Sample] = []
    for batch in range(4):
        wells, recipes = well_names(6 * batch, 6), recommender.ask(6)
        platform.make(wells, recipes)
        nm, spectra = platform.measure()
        labs = [lab_of(nm, spectra[well]) for well in wells]
        for well, recipe, lab in zip(wells, recipes, labs, strict=True):
            apart, xy = difference(lab, BLUE), chromaticity_of(nm, spectra[well])
            samples.append(Sample(batch, well, recipe, lab, xy, apart, nm, spectra[well]))
        recommender.tell(recipes, labs)
    return draw_convergence(samples, BLUE, 1.0)


def draw_pendant_drop() -> Figure:
    """Rates of three drops of the simulated beamline."""
    from drop_dynamics import dynamics_of
    from drop_report import Drop, draw_rates

    from tests.apps.simulated import series

    nothing = np.zeros((1, 1))
    seen = [series("water", "silica_50", seed=seed) for seed in range(3)]
    drops = [Drop(f"A{n + 1}", dynamics_of(s), s.temperature, nothing, nothing) for n, s in enumerate(seen)]
    return draw_rates(drops)


def draw_color_picker() -> Figure:
    """A plate after four batches, as the simulated camera shows it, and how near they came."""
    from color_picker import WELLS
    from color_report import Sample, draw_samples
    from color_solvers import distance, solver_of

    from labos.client.plate_reading import read_plate
    from tests.apps.plates import Plate

    plate, solver, samples = Plate(), solver_of("evolutionary", GREY, 3), list[Sample]()
    for batch in range(4):
        wells, mixtures = WELLS[12 * batch : 12 * batch + 12], solver.ask(12)
        plate.mix(wells, mixtures)
        picture = plate.picture()
        read = read_plate(picture, wells).colors
        fresh = [
            Sample(well, mixture, read[well], distance(read[well], GREY), 0)
            for well, mixture in zip(wells, mixtures, strict=True)
        ]
        solver.tell(mixtures, [sample.color for sample in fresh])
        samples += fresh
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(Image.open(io.BytesIO(picture)))
    left.set(xticks=[], yticks=[], title="what the camera sees")
    draw_samples(right, samples)
    right.set_title("distance to (120, 120, 120)")
    return figure


def draw_pcr() -> Figure:
    """The thermal programme of the standard payload."""
    import pcr

    return pcr.draw_programme(pcr.read_wanted(APPS / "pcr" / "payloads" / "standard.yaml").programme)


PICTURES = {
    "color_picker": draw_color_picker,
    "pcr": draw_pcr,
    "polymers": draw_polymers,
    "pendant_drop": draw_pendant_drop,
}


def draw_picture(app: str) -> bytes:
    """The picture of an application's page."""
    content = io.BytesIO()
    PICTURES[app]().savefig(content, format="png", dpi=90)
    return content.getvalue()


def picture_of(app: str) -> Path:
    return APPS / app / f"{app}.png"


def main() -> None:
    for app in PICTURES:
        sys.path.append(str(APPS / app))
    for app in PICTURES:
        picture_of(app).write_bytes(draw_picture(app))


if __name__ == "__main__":
    main()
