"""PCR as published, and ours, with the thermal programme in the log."""

from __future__ import annotations

import csv
from pathlib import Path

import pcr
import pytest
from PIL import Image

from labos.client import LabClient, RunFailed
from labos.errors import BadInput
from labos.node import World
from tests.apps.conftest import OpenLab
from tests.apps.support import cancel_at, list_standing, notes, says_the_same_again, until_clean

STANDARD = pcr.HERE / "payloads" / "standard.yaml"


def test_a_programme_repeats_its_cycle() -> None:
    programme = pcr.read_wanted(STANDARD).programme
    course = programme.course()
    assert len(course) == 2 * (1 + 3 * 30 + 2)
    assert course[-1] == pytest.approx(((120 + 30 * 120 + 300) / 60, 4.0))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("program: 3", "names no `programme`"),
        ("{programme: {steps: [{temperature_c: 95}]}}", "is no step of a programme"),
        ("{programme: {steps: [], colour: 1}}", "colour"),
        ("{programme: {steps: []}, program: 5}", "start program 3"),
        ("{programme: {steps: []}, plates: 0}", "must be 1 at least"),
        ("{programme: {steps: []}, lids: 0}", "'lids' is unknown"),
    ],
)
def test_a_payload_that_says_nothing_useful_is_refused(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "payload.yaml").write_text(text)
    with pytest.raises(BadInput, match=why):
        pcr.read_wanted(tmp_path / "payload.yaml")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_as_published_and_with_our_own_ending(open_lab: OpenLab, tmp_path: Path) -> None:
    with open_lab("rpl", 3000.0) as lab, LabClient(lab.url) as client:
        for published, ending in ((True, "are in the trash"), (False, "wait in the output hotel")):
            out = tmp_path / ending
            wanted = pcr.read_wanted(STANDARD)
            told = pcr.run_pcr(client, "ada", wanted, published=published, out=out)
            assert told.startswith(f"1 plates are done and {ending}. The data: experiment E")
            if published:
                resumed = lambda: pcr.run_pcr(client, "ada", wanted, published=True, out=out, resume="E1")  # noqa: B023, E731
                says_the_same_again(client, resumed, told)
            assert told.endswith(str(out / "index.html"))
            with (out / "data.csv").open() as file:
                (row,) = csv.DictReader(file)
            assert int(row["cycling_until"]) > int(row["cycling_from"]) > 0
            with Image.open(out / "plate1.jpg") as image:
                assert image.width > 500
            until_clean(client)
            assert list_standing(client) == ([] if published else ["wc.output", "wc.output.1"])
        programmes = notes(client, "thermal programme")
        assert notes(client, "the picture can be used") == []
    assert [(told["program"], told["cycles"]) for told in programmes] == [(3, 30), (3, 30)]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_picture_that_does_not_show_the_plate_is_told_with_it(open_lab: OpenLab, tmp_path: Path) -> None:
    camera = "model: camera (logitech)\n"
    spoilt = camera + "    config: {bad_pictures: 1.0}\n"
    with open_lab("rpl", 3000.0, (camera, spoilt)) as lab, LabClient(lab.url) as client:
        told = pcr.run_pcr(client, "ada", pcr.read_wanted(STANDARD), out=tmp_path / "out")
        (note,) = notes(client, "the picture can be used")
        assert client.file(note["picture"]).startswith(b"\xff\xd8")
    assert (note["error"], note["then"]) == ("experiment", "a person looks at the plate")
    assert note["why"] in ("saturated", "markers hidden", "plate not found")
    assert "Look at the plates of R1: their pictures are bad." in told
    assert "Pictures that do not show the plate well: R1." in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_cancelled_plate_is_brought_out(open_lab: OpenLab, tmp_path: Path) -> None:
    """Cancelled in the liquid handler, in the hot cycler, and under the camera: it waits for a person where
    the others do."""
    wanted = pcr.read_wanted(STANDARD)
    with open_lab("rpl", 3000.0) as lab, LabClient(lab.url) as client:
        for action in ("run_protocol", "run_program", "grab_image"):
            why = cancel_at(client, lambda: pcr.run_pcr(client, "ada", wanted, out=tmp_path / "out"), action)
            assert isinstance(why, RunFailed)
            assert why.result.status == "cancelled"
            until_clean(client)
            places = list_standing(client)
            assert places[0] == "wc.output", places
            assert all(place.startswith("wc.output") for place in places)
        assert not (tmp_path / "out").exists()
    world = World(str(lab.settings.world("rpl")))
    assert world.crashes() == []
    world.close()
