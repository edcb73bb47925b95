"""The pendant drop from the dock to the report: a simulated arm, and a real IOC over Channel Access."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.needed import need

need("aioca", "epics")
for package in ("scipy", "matplotlib"):
    pytest.importorskip(package)

from pendant_drop import Wanted, measure_diffusion

from labos.client import LabClient
from labos.settings import Settings
from tests.apps.beamline import Beamline
from tests.apps.conftest import OpenLab

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

SPEED = 2000.0
TRUTH = 4.9065e-12
"""m²/s, of spheres of 50 nm in water at 25 °C, by Stokes and Einstein."""


@contextmanager
def at_the_beamline(
    open_lab: OpenLab, tmp_path: Path, *faults: str, falls: float = 0.0
) -> Iterator[LabClient]:
    world = Settings.of(tmp_path / "lab").world("aps_8id")
    beamline = Beamline(tmp_path / "beamline", world, *faults)
    beamline.start()
    try:
        changes = (("127.0.0.1:5064", f"127.0.0.1:{beamline.port}"), ("falls: 0.1", f"falls: {falls}"))
        with open_lab("aps_8id", SPEED, *changes) as lab, LabClient(lab.url) as client:
            yield client
    finally:
        beamline.kill()


def test_the_diffusion_coefficient_is_that_of_stokes_and_einstein(open_lab: OpenLab, tmp_path: Path) -> None:
    wanted = Wanted("water", "silica_50", 0.89e-3, ["A1", "A2"])
    with at_the_beamline(open_lab, tmp_path) as client:
        found, told = measure_diffusion(client, "qi", wanted, out=tmp_path / "out")
        print(told, found)
    assert found.diffusion == pytest.approx(TRUTH, rel=0.08)
    assert found.radius == pytest.approx(50e-9, rel=0.08)
