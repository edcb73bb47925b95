"""Electrochromic polymers from a fresh plate to the report, on a simulated lab."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from PIL import Image
from polymers import Wanted, find_polymer

from labos.client import LabClient, RunFailed
from labos.node import World
from tests.apps.conftest import OpenLab
from tests.apps.support import cancel_at, list_standing, notes, says_the_same_again, until_clean

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

BLUE = (44.0, 12.0, -55.0)
SPEED = 20_000.0


def test_a_colour_is_found_and_its_data_is_where_the_last_line_says(
    open_lab: OpenLab, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with open_lab("cnm", SPEED, ("bubbles: 0.02", "bubbles: 0.3")) as lab, LabClient(lab.url) as client:
        told = find_polymer(client, "ada", Wanted(BLUE, tolerance=1.0), out=out)
        assert told.startswith("found: ")
        assert "experiment E1" in told
        assert told.endswith(str(out / "index.html"))
        again = notes(client, "no number in a spectrum")
        assert {note["error"] for note in again} == {"experiment"}
        assert "NaN" in client.file(again[0]["table"]).decode("utf-16-le")
        assert again[0]["then"] == "measured again (1)"
        assert [note["met"] for note in notes(client, "near enough")][-1] is True
        until_clean(client)
        assert list_standing(client) == []
        wanted = Wanted(BLUE, tolerance=1.0)
        says_the_same_again(client, lambda: find_polymer(client, "ada", wanted, out=out, resume="E1"), told)
    with (out / "data.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert min(float(row["difference_CIE2000"]) for row in rows) <= 1.0
    for picture in ("spectra.png", "convergence.png"):
        with Image.open(out / picture) as image:
            assert image.width > 500
    page = (out / "index.html").read_text()
    assert all(name in page for name in ("spectra.png", "convergence.png", "data.csv", "experiment E1"))
    world = World(str(lab.settings.world("cnm")))
    assert world.crashes() == []
    world.close()


def test_a_person_is_asked_of_saturated_spectra_and_a_cancelled_search_is_cleared_away(
    open_lab: OpenLab, tmp_path: Path
) -> None:
    with open_lab("cnm", 5000.0, ("bubbles: 0.02", "bubbles: 0")) as lab, LabClient(lab.url) as client:
        thick = Wanted(BLUE, tolerance=0.0, batches=2, wells=4, monomers_ul=240.0)
        told = find_polymer(client, "ada", thick, out=tmp_path / "out")
        assert told.startswith("not found: ")
        saturated = notes(client, "saturated spectrum")
        assert len(saturated[0]["wells"]) >= 1
        assert saturated[0]["then"] == "ask"
        table = client.file(saturated[0]["table"]).decode("utf-16-le")
        assert "4.0000" in table
        asked = [event["payload"] for event in client.events(type="run.submitted")]
        assert any("ecp_ask" in str(payload) for payload in asked)
        until_clean(client)

        for action in ("run_program", "measure_sample"):
            why = cancel_at(client, lambda: find_polymer(client, "ada", Wanted(BLUE), out=tmp_path), action)
            assert isinstance(why, RunFailed)
            assert why.result.status == "cancelled"
            until_clean(client)
            assert list_standing(client) == []
        assert not (tmp_path / "index.html").exists()
    world = World(str(lab.settings.world("cnm")))
    assert world.crashes() == []
    world.close()
