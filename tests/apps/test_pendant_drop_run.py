"""The pendant drop from the dock to the report: a simulated arm, and a real IOC over Channel Access."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pendant_drop import Wanted, measure_diffusion
from PIL import Image

from labos.client import LabClient, RunFailed
from labos.errors import LabosError
from labos.node import World
from labos.settings import Settings
from tests.apps.beamline import Beamline
from tests.apps.conftest import OpenLab
from tests.apps.support import cancel_at, list_standing, notes, says_the_same_again, until_clean
from tests.support.needed import need

need("aioca", "epics")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

SPEED = 2000.0
TRUTH = 4.9065e-12
"""m²/s, of spheres of 50 nm in water at 25 °C, by Stokes and Einstein."""


@contextmanager
def at_the_beamline(
    open_lab: OpenLab, tmp_path: Path, *faults: str, falls: float = 0.0
) -> Iterator[LabClient]:
    world = Settings.make(tmp_path / "lab").world("aps_8id")
    beamline = Beamline(tmp_path / "beamline", world, *faults)
    beamline.start()
    try:
        changes = (("127.0.0.1:5064", f"127.0.0.1:{beamline.port}"), ("falls: 0.1", f"falls: {falls}"))
        with open_lab("aps_8id", SPEED, *changes) as lab, LabClient(lab.url) as client:
            yield client
    finally:
        beamline.kill()


def drops_of(tmp_path: Path) -> list[dict[str, Any]]:
    """What really became of the drops, on a bench without a crash."""
    world = World(str(Settings.make(tmp_path / "lab").world("aps_8id")))
    try:
        assert world.crashes() == []
        return [motion.facts for motion in world.motions("run_droplet")]
    finally:
        world.close()


def test_the_diffusion_coefficient_is_that_of_stokes_and_einstein(open_lab: OpenLab, tmp_path: Path) -> None:
    """The first series is saturated and the second dark: both are taken again, of a new drop."""
    out = tmp_path / "out"
    wanted = Wanted("water", "silica_50", 0.89e-3, ["A1", "A2"])
    with at_the_beamline(open_lab, tmp_path, "bright", "dark") as client:
        found, told = measure_diffusion(client, "qi", wanted, out=out)
        assert [note["then"] for note in notes(client, "saturated series")] == [
            "again with a transmission of 0.0333"
        ]
        (dark,) = notes(client, "no number in g₂")
        assert (dark["error"], dark["well"], dark["then"]) == ("experiment", "A1", "again")
        counts = np.load(io.BytesIO(client.file(dark["series"])))
        assert counts.size == 256 * 40 * 40
        assert not counts.any()
        assert [note["well"] for note in notes(client, "diffusion coefficient")] == ["A1", "A2"]
        until_clean(client)
        resumed = lambda: measure_diffusion(client, "qi", wanted, out=out, resume="E1")[1]  # noqa: E731
        says_the_same_again(client, resumed, told)
    assert found.diffusion == pytest.approx(TRUTH, rel=0.08)
    assert found.radius == pytest.approx(50e-9, rel=0.08)
    assert len(drops_of(tmp_path)) == 4
    assert told.endswith(str(out / "index.html"))
    assert "experiment E1" in told
    for picture in ("g2.png", "rates.png", "drop.png"):
        with Image.open(out / picture) as image:
            assert image.width > 500
        assert picture in (out / "index.html").read_text()


def test_a_person_is_asked_when_no_drop_is_seen_and_a_cancelled_drop_leaves_no_tip(
    open_lab: OpenLab, tmp_path: Path
) -> None:
    wanted = Wanted("water", "silica_50", 0.89e-3, ["B1"], again=1, no_drop="ask")
    with at_the_beamline(open_lab, tmp_path, falls=1.0) as client:
        with pytest.raises(LabosError, match="No drop of E1 gave a series"):
            measure_diffusion(client, "qi", wanted, out=tmp_path / "out")
        unseen = notes(client, "no drop seen")
        assert [note["then"] for note in unseen] == ["a person is asked"] * 2
        assert np.load(io.BytesIO(client.file(unseen[0]["microscope"]))).size == 64 * 64
        until_clean(client)
        for action in ("create_sample", "run_droplet"):
            why = cancel_at(client, lambda: measure_diffusion(client, "qi", wanted, out=tmp_path), action)
            assert isinstance(why, RunFailed)
            assert why.result.status == "cancelled"
            until_clean(client)
            assert list_standing(client) == ["wc.wells"]
    assert all(facts["fell"] for facts in drops_of(tmp_path))
    assert not (tmp_path / "out").exists()
