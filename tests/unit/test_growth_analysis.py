"""The growth assay's analysis, against the truth of the simulated bench and on useless readings."""

from __future__ import annotations

import math
from typing import Any

import pytest

from labos_drivers._growth import CELLS_OD, HILL, IC50_MG_PER_L, compute_growth
from labos_drivers.ot2.simulator import find_dispensed as find_dispensed_ot2
from labos_drivers.solo.protocol import POSITIONS, count_used_tips, find_dispensed, find_flaw
from tests.apps.growth import APP, STOCK, table

pytest.importorskip("scipy")
pytest.importorskip("matplotlib")

import growth_analysis
import growth_layout
import growth_plots

TRUTH = IC50_MG_PER_L["tetracycline"]
TOLERANCE = 0.1
"""Of the fitted concentration, relative: what the README states."""

WARM = (12.0, 37.0)


def readings(seed: int) -> tuple[dict[str, float], dict[str, float]]:
    return (
        growth_analysis.check(table(seed=seed), "T0"),
        growth_analysis.check(table(WARM, seed=seed + 1000), "T12"),
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_fit_finds_what_the_bench_knows(seed: int) -> None:
    first, last = readings(seed)
    curve = growth_analysis.fit([first], [last])
    assert curve.ic50 == pytest.approx(TRUTH, rel=TOLERANCE)
    assert curve.hill == pytest.approx(HILL, rel=0.15)
    assert abs(curve.ic50 - TRUTH) < 5 * curve.ic50_error + 0.01 * TRUTH


def test_ten_plates_are_nearer_than_one_on_the_whole() -> None:
    pairs = [readings(seed) for seed in range(10)]
    curve = growth_analysis.fit([first for first, _ in pairs], [last for _, last in pairs])
    single = growth_analysis.fit([pairs[0][0]], [pairs[0][1]])
    assert curve.ic50 == pytest.approx(TRUTH, rel=0.03)
    assert curve.ic50_error < single.ic50_error


def test_blanks_are_taken_off() -> None:
    """At the start a well of cells shows half of what the suspension does: it is diluted once."""
    first, last = readings(3)
    for column in growth_analysis.summarise(first):
        assert column.mean == pytest.approx(CELLS_OD / 2, abs=0.015)
        assert 0 < column.error < 0.01
    assert [column.dose for column in growth_analysis.summarise(last)][:3] == [0, 0, 32]
    assert growth_analysis.summarise(last)[0].mean > 20 * growth_analysis.summarise(last)[2].mean / 2


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        ({"A1": None}, "1 of 96 wells have no value: A1"),
        ({"H12": math.nan, "B3": math.inf}, "2 of 96 wells have no value: B3, H12"),
        ({"C4": "OVER"}, "C4"),
        ({"C4": True}, "C4"),
        (
            {f"A{column}": None for column in range(1, 13)},
            "12 of 96 wells have no value: A1, A2, A3, A4, A5 …",
        ),
    ],
)
def test_readings_without_a_value_are_refused(spoil: dict[str, Any], why: str) -> None:
    spoilt = table(WARM)
    spoilt["wells"].update(spoil)
    with pytest.raises(growth_analysis.BadReading, match="R7 at T12: ") as refused:
        growth_analysis.check(spoilt, "R7 at T12")
    assert why in refused.value.message
    assert refused.value.remedy


@pytest.mark.parametrize("shown", [None, "file.csv", {}, {"wells": [1, 2]}, {"wells": {}}])
def test_what_is_no_table_is_refused(shown: Any) -> None:
    with pytest.raises(growth_analysis.BadReading):
        growth_analysis.check(shown, "R7 at T0")


@pytest.mark.parametrize(
    "last", [table(seed=5), table((12.0, 4.0), seed=6), table(WARM, seed=7, cells=False)]
)
def test_where_nothing_has_grown_nothing_is_fitted(last: dict[str, Any]) -> None:
    """Read twice at once, kept cold, or made without cells."""
    first = growth_analysis.check(table(seed=1), "T0")
    with pytest.raises(growth_analysis.BadReading, match="nothing has grown"):
        growth_analysis.fit([first], [growth_analysis.check(last, "T12")])


def test_both_protocols_make_the_same_plate() -> None:
    """And they are those that the layout says."""
    ot2, solo = APP / "rpl/protocols/assay_plate.yaml", APP / "bio/protocols/assay_plate.hso"
    assert ot2.read_text() == growth_layout.for_ot2(), "run growth_layout.py"
    assert solo.read_bytes().decode() == growth_layout.for_solo(), "run growth_layout.py"
    in_reservoir = {"A1": "medium", "A2": "cells", "A3": "strong", "A4": "weak"}
    by_ot2 = find_dispensed_ot2(str(ot2), {f"reservoir:{well}": what for well, what in in_reservoir.items()})
    at = {"Position1": "medium", "Position2": "cells", "Position5": "strong", "Position6": "weak"}
    by_solo = find_dispensed(growth_layout.for_solo(), at)
    wanted = {
        liquid: {well: ul for well, ul in growth_layout.volumes(liquid).items() if ul}
        for liquid in growth_layout.LIQUIDS
    }
    assert by_ot2 == by_solo == wanted
    assert {
        sum(by[well] for by in wanted.values() if well in by) for well in growth_layout.volumes("medium")
    } == {200}


def test_the_solo_takes_its_protocol() -> None:
    text = growth_layout.for_solo()
    assert find_flaw(text) == ""
    assert count_used_tips("assay_plate.hso", text.encode(), {}).doubt == ""
    assert len(text.splitlines()[:POSITIONS]) == POSITIONS


def test_growth_needs_warmth_cells_and_time() -> None:
    full = {"cells": 100.0, "medium": 100.0}
    assert compute_growth({"medium": 200.0}, [WARM]) == 0.0
    assert compute_growth({}, [WARM]) == 0.0
    assert compute_growth(full, []) == pytest.approx(CELLS_OD / 2)
    hours = [compute_growth(full, [(h, 37.0)]) for h in (0, 2, 5, 8, 12, 48)]
    assert hours == sorted(hours)
    assert compute_growth(full, [(6.0, 37.0), (6.0, 37.0)]) == pytest.approx(compute_growth(full, [WARM]))
    assert compute_growth(full, [(12.0, 20.0)]) < 0.2 * compute_growth(full, [WARM])
    half = {**full, STOCK["weak"]: 0.0}
    assert compute_growth(half, [WARM]) == pytest.approx(compute_growth(full, [WARM]))


def test_the_plots_hold_what_they_show(tmp_path: Any) -> None:
    first, last = readings(2)
    curve = growth_analysis.fit([first], [last])
    figure = growth_plots.draw([first], [last], curve, "tetracycline")
    figure.savefig(tmp_path / "growth.png")
    picture = (tmp_path / "growth.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
