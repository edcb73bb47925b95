"""The color picker from a fresh plate to the report, on a simulated lab."""

from __future__ import annotations

import csv
import json
import re
import sys
from pathlib import Path

import color_picker
import pytest
from color_picker import Wanted, pick_color
from PIL import Image

from labos.client import LabClient, RunFailed
from labos.node import World
from tests.apps.conftest import OpenLab
from tests.apps.support import cancel_at, notes, says_the_same_again, standing, until_clean

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

GREY = (120.0, 120.0, 120.0)


def test_a_colour_is_looked_for_and_its_data_is_where_the_last_line_says(
    open_lab: OpenLab,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    (tmp_path / "wanted.yaml").write_text(
        "{target: [120, 120, 120], samples: 12, batch: 6, handlers: [ot2_cp_gamma, ot2_growth_beta]}"
    )
    with open_lab("rpl_picker", 3000.0, ("bad_pictures: 0.02", "bad_pictures: 0.3")) as lab:
        words = ["--url", lab.url, "--payload", str(tmp_path / "wanted.yaml"), "--out", str(out)]
        monkeypatch.setattr(sys, "argv", ["color_picker", *words])
        assert color_picker.main() == 0
        told = capsys.readouterr().out
        with LabClient(lab.url) as client:
            until_clean(client)
            assert standing(client) == []
            published = notes(client, "samples")
            kept = json.loads(client.file(published[0]["file"]))

            def resumed() -> str:
                monkeypatch.setattr(sys, "argv", ["color_picker", *words, "--resume", "E1"])
                assert color_picker.main() == 0
                return capsys.readouterr().out

            says_the_same_again(client, resumed, told)
    assert told.startswith("color picker: not found: a distance of ")
    assert told.rstrip().endswith(str(out / "index.html"))
    assert len(kept) == published[0]["count"] > 0
    with (out / "data.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert 6 <= len(rows) <= 12
    for picture in ("distance.png", "plate.jpg"):
        with Image.open(out / picture) as image:
            assert image.width > 500
    assert "data:image/jpeg;base64," in (out / "index.html").read_text()
    world = World(str(lab.settings.world("rpl_picker")))
    assert world.crashes() == []
    world.close()


def test_a_cancelled_search_is_cleared_away(open_lab: OpenLab, tmp_path: Path) -> None:
    with open_lab("rpl_picker", 1000.0) as lab, LabClient(lab.url) as client:
        for action, handlers in (
            ("run_protocol", ["ot2_cp_gamma"]),
            ("grab_image", ["ot2_cp_gamma", "ot2_growth_beta", "ot2_pcr_alpha"]),
        ):
            wanted = Wanted(GREY, samples=6, batch=6, handlers=handlers)
            work = lambda wanted=wanted: pick_color(client, "bo", wanted, out=tmp_path)  # noqa: E731
            why = cancel_at(client, work, action)
            if isinstance(why, RunFailed):
                assert why.result.status == "cancelled"
            else:  # another liquid handler was about to go on
                assert re.search("E2 is (cancelled|closing|not open)", str(why)), why
            until_clean(client)
            assert standing(client) == []
        assert not (tmp_path / "index.html").exists()
