"""Electrochromic polymers from a fresh plate to the report, on a simulated lab."""

from __future__ import annotations

import re
import threading
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("colour")
pytest.importorskip("sklearn")

from polymers import Wanted, find_polymer

from labos.client import LabClient, RunFailed
from tests.apps.conftest import OpenLab

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

VIOLET = (44.0, 12.0, -55.0)
SPEED = 40_000.0


def notes(client: LabClient, name: str) -> list[dict[str, Any]]:
    found = client.events(type="experiment.noted")
    return [event["payload"]["facts"] for event in found if event["payload"]["name"] == name]


def places(client: LabClient) -> dict[str, int]:
    return {s["name"].rpartition("/")[2]: len(s["labware"]) for s in client.state()["stations"] if s["labware"]}


def test_a_colour_is_found_and_its_data_is_where_the_last_line_says(open_lab: OpenLab, tmp_path: Path) -> None:
    with open_lab("cnm", SPEED, ("bubbles: 0.02", "bubbles: 0.3")) as lab, LabClient(lab.url) as client:
        told = find_polymer(client, "ada", Wanted(VIOLET), out=tmp_path / "out")
        print(told)
        assert told.startswith("found: ")
        again = notes(client, "no number in a spectrum")
        assert again
        assert client.file(again[0]["table"])
        print(places(client))
    page = tmp_path / "out" / "index.html"
    assert told.endswith(str(page))
