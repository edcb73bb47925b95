"""Colours that are read from pictures, solvers, and the search on a lab in virtual time."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from random import Random
from statistics import median

import numpy as np
import pytest
from color_picker import FLOWS, WELLS, Search, Wanted, parkings_of, read_wanted
from color_solvers import LEAST_UL, MOST_UL, SOLVERS, Mixture, distance, solver_of

from labos.client.plate_reading import BadPicture, read_plate
from labos.errors import BadInput
from labos_drivers._optics import color_of
from tests.apps import color_study
from tests.apps.plates import Plate
from tests.apps.virtual_lab import VirtualExperiment, VirtualLab

GREY = (120.0, 120.0, 120.0)


def some(count: int, seed: int = 0) -> list[Mixture]:
    return solver_of("random", GREY, seed).ask(count)


# -- pictures --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "seed"), [(1, 0), (8, 1), (96, 2)])
def test_colours_are_those_of_the_dyes_whatever_the_light(count: int, seed: int) -> None:
    plate = Plate(seed)
    plate.mix(WELLS[:count], some(count, seed))
    read = read_plate(plate.picture(), WELLS[:count])
    truth = plate.colors()
    apart = np.array([np.subtract(read.colors[well], truth[well]) for well in truth])
    assert abs(apart).max() < 5
    assert abs(apart).mean() < 2


def test_a_picture_that_is_turned_is_read_as_well() -> None:
    plate = Plate()
    plate.mix(["A1", "H12"], some(2))
    read = read_plate(plate.picture(rotation_deg=180), ["A1", "H12"])
    assert all(distance(color, plate.colors()[well]) < 8 for well, color in read.colors.items())


@pytest.mark.parametrize(
    ("trouble", "kind"),
    [("overexposed", "saturated"), ("hidden", "markers hidden"), ("askew", "plate not found")],
)
def test_a_bad_picture_says_why(trouble: str, kind: str) -> None:
    plate = Plate()
    plate.mix(WELLS[:8], some(8))
    with pytest.raises(BadPicture) as bad:
        read_plate(plate.picture(trouble), WELLS[:8])
    assert bad.value.kind == kind


def test_without_a_plate_or_a_picture_nothing_is_read() -> None:
    with pytest.raises(BadPicture, match="Only 0 wells"):
        read_plate(Plate().picture(empty=True), ["A1"])
    with pytest.raises(BadPicture, match="no picture"):
        read_plate(b"no picture", ["A1"])


# -- solvers ---------------------------------------------------------------------------------------


def searched(name: str, seed: int, samples: int, batch: int = 8) -> float:
    """How near a solver comes, if colours are seen as they are but for a little noise."""
    solver, noise, nearest = solver_of(name, GREY, seed), Random(seed), float("inf")
    for _ in range(samples // batch):
        mixtures = solver.ask(batch)
        assert len(mixtures) == batch
        assert all(LEAST_UL <= ul <= MOST_UL for mixture in mixtures for ul in mixture)
        dyes = [dict(zip(("color_A", "color_B", "color_C"), mixture, strict=True)) for mixture in mixtures]
        colors = [tuple(part + noise.gauss(0, 0.7) for part in color_of(each)) for each in dyes]
        solver.tell(mixtures, colors)  # type: ignore[arg-type]
        nearest = min(nearest, *(distance(color, GREY) for color in colors))  # type: ignore[arg-type]
    return nearest


def test_a_solver_proposes_the_same_again_with_the_same_seed() -> None:
    for name in SOLVERS:
        assert (
            solver_of(name, GREY, 3).ask(5)
            == solver_of(name, GREY, 3).ask(5)
            != solver_of(name, GREY, 4).ask(5)
        )


def test_the_evolutionary_solver_comes_nearer_than_chance() -> None:
    by_chance = median(searched("random", seed, 64) for seed in range(9))
    assert median(searched("evolutionary", seed, 64) for seed in range(9)) < 0.75 * by_chance


@pytest.mark.slow
def test_the_bayesian_solver_comes_nearer_than_chance_in_few_samples() -> None:
    assert median(searched("bayesian", seed, 32) for seed in range(3)) < 4


def test_a_grid_is_gone_through_once_and_then_made_finer() -> None:
    solver = solver_of("grid", GREY, 0)
    first, more = solver.ask(125), solver.ask(125)
    assert len(set(first)) == len(set(more)) == 125
    steps = sorted({mixture.a for mixture in first})
    assert [b - a for a, b in pairwise(steps)] == pytest.approx([17.5] * 4)


# -- the search ------------------------------------------------------------------------------------


def search_on(lab: VirtualLab, wanted: Wanted, seed: int = 0) -> Search:
    parkings = parkings_of(wanted)
    experiment = VirtualExperiment(
        lab, "color picker", "bo", closing=FLOWS / "trash_plates.yaml", parkings=parkings
    )
    search = Search(lab, experiment, wanted, seed)  # type: ignore[arg-type]
    search.run()
    return search


@pytest.mark.slow
def test_bad_pictures_are_told_with_the_picture_and_taken_again() -> None:
    with VirtualLab("rpl_picker", 5, config={"camera_module": {"bad_pictures": 0.8}}) as lab:
        search = search_on(lab, Wanted(GREY, samples=8, batch=4, close=0.0, photograph_again=1))
        notes = [facts for _, name, facts in lab.notes if name == "the picture can be used"]
        asked = [run for run in lab.runs() if run.workflow == "picker_ask"]
    assert len(search.samples) in (0, 4, 8)
    assert notes
    assert {note["error"] for note in notes} == {"experiment"}
    assert {note["why"] for note in notes} <= {"saturated", "markers hidden", "plate not found"}
    assert all(lab.kept[note["picture"]["sha256"]].startswith(b"\xff\xd8") for note in notes)
    assert notes[0]["then"] == "photograph again"
    assert len(asked) == sum(note["then"] == "a person is asked" for note in notes) > 0


@pytest.mark.slow
def test_a_full_plate_is_replaced_by_a_fresh_one() -> None:
    with VirtualLab("rpl_picker", 1, config={"camera_module": {"bad_pictures": 0.0}}) as lab:
        search = search_on(lab, Wanted(GREY, samples=128, batch=64, close=0.0))
        runs = [run.workflow for run in lab.runs()]
        assert lab.differences(lab.fold_log()) == []
    assert [sample.well for sample in search.samples] == [*WELLS, *WELLS[:32]]
    mix = "picker_mix_and_photograph"
    one, away = ["picker_new_plate", mix, mix], "picker_trash_plate"
    assert runs == [*one, away, "picker_new_plate", mix, away]


@pytest.mark.slow
def test_three_liquid_handlers_at_once_are_quicker_than_one() -> None:
    ended = {}
    for count in (1, 3):
        handlers = ["ot2_cp_gamma", "ot2_growth_beta", "ot2_pcr_alpha"][:count]
        with VirtualLab("rpl_picker", 1) as lab:
            search = search_on(lab, Wanted(GREY, samples=48, batch=48, close=0.0, handlers=handlers))
            assert lab.world.crashes() == []
            assert lab.differences(lab.fold_log()) == []
            ended[count] = max(sample.mixed_at for sample in search.samples)
            assert len(search.samples) == 48
    began = 1_800_000_000 * 10**9
    assert (ended[1] - began) / (ended[3] - began) > 1.8


@pytest.mark.slow
def test_samples_are_told_in_the_order_of_their_decision_whichever_liquid_handler_is_quicker() -> None:
    """A program that is started again may hear of the ends in another order."""
    config = {"ot2_cp_gamma": {"dose_s": 90.0}, "camera_module": {"bad_pictures": 0.0}}
    with VirtualLab("rpl_picker", 1, config=config) as lab:
        handlers = ["ot2_cp_gamma", "ot2_growth_beta"]
        search = search_on(lab, Wanted(GREY, samples=4, batch=4, close=0.0, handlers=handlers))
        (decided,) = [facts["value"] for _, name, facts in lab.notes if name == "next mixtures"]
    assert [list(sample.mixture) for sample in search.samples] == decided
    assert search.samples[0].mixed_at > search.samples[-1].mixed_at


# -- what it is given ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("samples: 3", "names no `target`"),
        ("target: [1, 2]", "is no colour"),
        ("target: [1, 2, 300]", "is no colour"),
        ("target: [1, 2, x]", "could not convert"),
        ("{target: [1, 2, 3], batch: 0}", "must be 1 at least"),
        ("{target: [1, 2, 3], handlers: []}", "names none"),
        ("{target: [1, 2, 3], bad_pictures: no}", "is unknown"),
        ("{target: [1, 2, 3], colour: blue}", "'colour' is unknown"),
        ("{target: [", "cannot be read"),
    ],
)
def test_a_payload_that_says_nothing_useful_is_refused(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "payload.yaml").write_text(text)
    with pytest.raises(BadInput, match=why):
        read_wanted(tmp_path / "payload.yaml")


def test_an_unknown_solver_is_refused() -> None:
    with pytest.raises(BadInput, match="evolutionary, bayesian, grid, random"):
        solver_of("lucky", GREY, 0)


# -- the study -------------------------------------------------------------------------------------


def test_the_page_of_the_study_shows_what_is_in_its_data() -> None:
    page, found = color_study.PAGE.read_text("utf-8"), color_study.kept()
    assert {told.case for told in found} == set(color_study.cases())
    for table in color_study.tables(found).values():
        assert table in page
    assert all(told.samples[-1] >= 0.9 * color_study.SAMPLES for told in found)
    assert all(a >= b for told in found for a, b in pairwise(told.best))


@pytest.mark.slow
def test_an_experiment_of_the_study_tells_distance_over_lab_time() -> None:
    told = color_study.carry_out(color_study.Case("evolutionary", 8, 1, 0), samples=16)
    assert told.samples[-1] <= 16
    assert len(told.hours) == len(told.best) == len(told.samples)
    assert 0 < told.hours[0] < told.hours[-1] < 1
