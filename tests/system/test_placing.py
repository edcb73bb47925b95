"""``--place``: labware and run are recorded together, or neither is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.errors import BadInput, NotFound, Refused
from tests.support.lab_process import Up, labos

pytestmark = pytest.mark.timeout(180)

HERE = "hidex.default=plate96"
PICTURE = """\
labos: 1
name: picture
steps:
  - {name: look, module: camera_module, action: take_picture, args: {file_name: a.jpg}}
"""
UNKNOWN = PICTURE.replace("camera_module", "camara_module")


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "2000")
    yield up.start_with("sciclops", "pf400", "sealer", "peeler", "hidex", "camera_module")
    up.clean_up()


def changes(lab: Up) -> list[str]:
    """What the log tells of labware and of runs."""
    kinds = [record.head.type for record in lab.records()]
    return [kind for kind in kinds if kind.partition(".")[0] in ("labware", "station", "run", "plan")]


def test_what_is_refused_leaves_nothing_on_the_bench(lab: Up, tmp_path: Path) -> None:
    bad, good = tmp_path / "bad.yaml", tmp_path / "good.yaml"
    bad.write_text(UNKNOWN)
    good.write_text(PICTURE)
    home = ("--home", str(lab.home), "--user", "ada")
    before, told = lab.bench(), changes(lab)

    refused = labos("run", str(bad), "--place", HERE, *home)
    assert (refused.returncode, "camara_module" in refused.stderr) == (1, True), refused.stderr
    second = labos("run", str(good), "--place", HERE, "--place", "sealer.nowhere=plate96", *home)
    assert (second.returncode, "sealer.nowhere" in second.stderr) == (1, True), second.stderr
    twice = labos("run", str(good), "--place", HERE, "--place", HERE, *home)
    assert (twice.returncode, "room for 1 more, not for 2" in twice.stderr) == (1, True), twice.stderr
    unclear = labos("run", str(good), "--place", HERE, "--place", "hidex.default", *home)
    assert (unclear.returncode, "STATION=TYPE" in unclear.stderr) == (2, True), unclear.stderr
    queued = labos("do", "camera_module", "take_pictur", "--place", HERE, "--no-wait", *home)
    assert (queued.returncode, "take_picture" in queued.stderr) == (1, True), queued.stderr
    with lab.client() as client:
        with pytest.raises(Refused, match="E9 is not open"):
            client.submit(good, user="ada", place=[("hidex.default", "plate96")], experiment="E9")
        with pytest.raises(NotFound, match="no labware type 'plate69'"):
            client.submit(good, user="ada", place=[("hidex.default", "plate69")])
        stack = [("sciclops.tower5", "plate96"), ("sciclops.tower5", "pcr96")]
        with pytest.raises(BadInput, match="plate96 and pcr96 cannot both be put on"):
            client.submit(good, user="ada", place=stack)
    assert (lab.bench(), changes(lab)) == (before, told), "nothing is half-done"


def test_what_labware_is_may_be_said_with_it(lab: Up) -> None:
    """A seal and a lid, in the lab's own record and on the bench."""
    home = ("--home", str(lab.home), "--user", "ada")
    for words, why in (
        ("peeler.default=plate96,sealled", "'sealled'. Did you mean 'sealed'?"),
        ("hidex.default=plate96+lid96,not lidded", "has a lid, but is given as not lidded"),
        ("peeler.default=plate96,", "is not STATION=TYPE"),
    ):
        refused = labos("do", "peeler", "peel", "--place", words, *home)
        assert (refused.returncode, why in refused.stderr) != (0, False), refused.stderr
        assert why in refused.stderr, refused.stderr
    peeled = labos("do", "peeler", "peel", "--place", "peeler.default=plate96,sealed", "--quiet", *home)
    assert peeled.returncode == 0, peeled.stdout + peeled.stderr
    place = ("--place", "camera_module.plate_station=plate96,lidded", "--quiet")
    taken = labos("do", "camera_module", "take_picture", "file_name=a.jpg", *place, *home)
    assert taken.returncode == 0, taken.stdout + taken.stderr
    # It is queued with its labware, as what is waited for is.
    queued = labos("do", "peeler", "peel", "--place", "wc.output=plate96,not sealed", "--no-wait", *home)
    assert queued.returncode == 0, queued.stderr
    with lab.client() as client:
        plates = {item["station"]: item for item in client.state()["labware"]}
        waits = [wait["why"] for run in client.state()["runs"] for wait in run["waits"]]
        client.cancel(queued.stdout.strip(), "ada")
    assert plates["peeler.default"]["variables"] == {"sealed": False}
    seen = plates["camera_module.plate_station"]
    assert (seen["type"], bool(seen["lid"])) == ("plate96", True)
    assert plates["wc.output.1"]["variables"] == {"sealed": False}
    assert waits, "nothing that is sealed stands at the peeler"
    assert lab.interrupt() == 0
    assert lab.disagreements() == ["person did seal 1 times, the log says 0"], "whoever brought it sealed"


@pytest.mark.smoke
def test_what_is_accepted_stands_there_and_runs(lab: Up, tmp_path: Path) -> None:
    good = tmp_path / "good.yaml"
    good.write_text(PICTURE)
    place = ("--place", HERE, "--place", "camera_module.plate_station=plate96")
    done = labos("run", str(good), *place, "--home", str(lab.home), "--user", "ada")
    assert done.returncode == 0, done.stdout + done.stderr
    bench = lab.bench()
    assert (len(bench["hidex.default"]), len(bench["camera_module.plate_station"])) == (1, 1)
    with lab.client() as client:
        there = [("peeler.default", "plate96"), ("wc.output", "plate96"), ("wc.output", "plate96")]
        first = client.submit(good, user="ada", place=there, request="once")
        assert client.submit(good, user="ada", place=there, request="once") == first, "said twice, done once"
        with pytest.raises(Refused, match="another workflow, payload or options"):
            client.submit(good, user="ada", request="once")
        assert client.wait(first).succeeded
    bench = lab.bench()
    assert [len(bench[place]) for place in ("peeler.default", "wc.output.1", "wc.output.2")] == [1, 1, 1]
    assert lab.interrupt() == 0
    assert lab.disagreements() == []
