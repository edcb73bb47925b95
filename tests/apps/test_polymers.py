"""Colours of what the simulated platform made and the simulated reader saw, and the way to a wanted one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from polymer_colours import chromaticity_of, difference, judge, lab_of, read_table, rgb_of
from polymer_recommender import Recipe, Recommender
from polymers import Wanted, read_wanted, well_names

from labos.errors import BadInput
from labos.node import DeviceError
from tests.apps.simulated import Platform

ORANGE, CYAN = Recipe(0.75, 0.0, 0.25, 30.0), Recipe(0.0, 0.1, 0.9, 40.0)


def test_a_well_has_a_spectrum_by_its_monomers_and_chain_length() -> None:
    platform = Platform()
    shorter = ORANGE._replace(length=6.0)
    platform.make(["A1", "A2", "H12"], [ORANGE, shorter, CYAN])
    spectra = platform.measure()
    assert (spectra.nm[0], spectra.nm[-1], len(spectra.od)) == (300.0, 1000.0, 96)
    peaks = {well: spectra.nm[np.argmax(spectra.od[well])] for well in ("A1", "A2", "H12")}
    assert peaks["A2"] < peaks["A1"] < peaks["H12"], "long chains and acceptors absorb redder light"
    assert max(spectra.od["B1"]) < 0.1, "nothing was made there"
    again = platform.measure()
    apart = again.od["A1"] - spectra.od["A1"]
    assert 0 < np.std(apart) < 0.02, "the same but for noise"


def test_a_synthesis_without_a_plate_or_with_too_few_values_moves_nothing() -> None:
    platform = Platform()
    with pytest.raises(DeviceError, match="2 wells, but 1 values of monomer_A") as short:
        platform.make(["A1", "A2"], [ORANGE])
    assert short.value.effects == "none"
    platform.world.carry(platform.plate, "")
    with pytest.raises(DeviceError, match="no plate to fill"):
        platform.make(["A1"], [ORANGE])
    assert platform.world.motions("synthesise") == []


def test_a_bubble_is_no_number_until_the_plate_is_read_again() -> None:
    platform = Platform(bubbles=1.0)
    platform.make(["A1", "C7"], [ORANGE, CYAN])
    assert judge(platform.measure(), ["A1", "C7"]) == ([], ["A1", "C7"], [])
    assert judge(platform.measure(), ["A1", "C7"]) == (["A1", "C7"], [], [])


def test_too_much_is_saturated() -> None:
    platform = Platform()
    platform.make(["A1", "A2"], [ORANGE, CYAN], monomers_ul=250.0)
    spectra = platform.measure()
    assert max(spectra.od["A2"]) == 4.0
    assert "A2" in judge(spectra, ["A1", "A2"]).saturated
    assert judge(spectra, ["A1", "A2", "Z9"]).no_number == ["Z9"]


def test_colours_are_those_of_the_standard() -> None:
    nm = np.arange(300.0, 1001.0, 10.0)
    assert lab_of(nm, np.zeros_like(nm)) == pytest.approx((100.0, 0.0, 0.0), abs=0.05)
    assert chromaticity_of(nm, np.zeros_like(nm)) == pytest.approx((0.3127, 0.3290), abs=5e-4)
    assert lab_of(nm, np.full_like(nm, np.log10(2))) == pytest.approx((76.07, 0.0, 0.0), abs=0.05)
    assert rgb_of((100.0, 0.0, 0.0)) == pytest.approx((1.0, 1.0, 1.0), abs=1e-3)
    # the first pair of Sharma, Wu and Dalal (2005)
    assert difference((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485)) == pytest.approx(2.0425, abs=1e-3)


def slow(*values: object) -> object:
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize("seed", [0, 1, 2, slow(3), slow(4), slow(5)])
@pytest.mark.parametrize(
    "target", [(44.0, 12.0, -55.0), slow((60.0, 49.0, 16.0)), slow((76.0, -33.0, -33.0))]
)
def test_the_recommender_comes_within_what_is_just_seen(
    target: tuple[float, float, float], seed: int
) -> None:
    """At most ten batches of six; each measured as the reader does, with its noise."""
    platform, recommender = Platform(seed), Recommender(target, difference, seed)
    nearest = []
    for batch in range(10):
        wells, recipes = well_names(6 * batch, 6), recommender.ask(6)
        platform.make(wells, recipes)
        spectra = platform.measure()
        recommender.tell(recipes, [lab_of(spectra.nm, spectra.od[well]) for well in wells])
        nearest.append(recommender.nearest)
        if recommender.nearest <= 1.0:
            break
    assert nearest[-1] <= 1.0, nearest
    assert nearest[-1] < nearest[0] or len(nearest) == 1


def test_a_recipe_is_whole_and_none_is_made_twice_in_a_batch() -> None:
    recommender = Recommender((44.0, 12.0, -55.0), difference, 3)
    for _ in range(3):
        recipes = recommender.ask(6)
        assert all(sum(recipe[:3]) == pytest.approx(1.0, abs=2e-3) and min(recipe) >= 0 for recipe in recipes)
        assert len(set(recipes)) == 6
        recommender.tell(recipes, [(recipe.a * 100, recipe.b, recipe.c) for recipe in recipes])


def test_another_file_than_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="does not begin"):
        read_table("well,od\r\nA1,0.3\r\n".encode("utf-16-le"))
    with pytest.raises(ValueError, match="A2 has another number"):
        read_table("*\t300nm\t310nm\r\nA1\t1\t2\r\nA2\t1\r\n".encode("utf-16-le"))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("tolerance: 1", "names no `target`"),
        ("target: [1, 2]", "three numbers"),
        ("target: [1, 2, 3]\nbatchs: 3", "'batchs' is unknown"),
        ("target: [1, 2, 3]\nbatches: 20", "more than a plate has"),
        ("target: [1, 2, 3]\nsaturated: never", "`saturated: never` is unknown"),
        ("target: [1, x, 3]", "could not convert"),
        ("target: [", "cannot be read"),
    ],
)
def test_a_bad_payload_is_refused_with_its_reason(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "payload.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=why):
        read_wanted(path)


def test_the_packaged_payload_is_good() -> None:
    from polymers import HERE

    assert read_wanted(HERE / "payloads" / "blue.yaml") == Wanted((44.0, 12.0, -55.0))
