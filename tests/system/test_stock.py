"""``labos load``, ``unload``, ``replenish`` and ``inventory``, on real processes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import LabosError
from tests.support.lab_process import Up, labos, until


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "1000")
    yield up
    up.clean_up()


pytestmark = pytest.mark.timeout(180)


def stack(inventory: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(s for s in inventory["stacks"] if s["station"] == f"rpl/{name}")
    return found


def test_stacks_are_loaded_and_unloaded_and_resources_refilled(lab: Up) -> None:
    lab.start_with("sciclops", "pf400", "sealer")
    home = ("--home", str(lab.home))
    user = (*home, "--user", "ada")

    def inventory() -> dict[str, Any]:
        told = labos("inventory", "--json", *home)
        assert told.returncode == 0, told.stderr
        found: dict[str, Any] = json.loads(told.stdout)
        return found

    assert labos("unload", "sciclops.tower1", "--all", *user).returncode == 0
    with lab.client() as client:
        waiting = client.do("sciclops", "get_plate", {"loc": "tower1"}, user="ada")
        empty = "the stack sciclops.tower1 is empty"
        until(lambda: client.state()["runs"][0]["waits"][0]["why"] == empty, empty)
        assert stack(client.inventory(), "sciclops.tower1")["count"] == 0
        out = stack(inventory(), "sciclops.tower1")["runs_out"]
        assert (out["run"], out["workflow"]) == (waiting, "do sciclops.get_plate")
        wrong = labos("load", "sciclops.tower1", "--type", "tiprack", *user)
        assert (wrong.returncode, "Traceback" in wrong.stderr) == (1, False)
        full = labos("load", "sciclops.tower1", "--type", "plate96", "--count", "9999", *user)
        assert (full.returncode, "has room for" in full.stderr) == (1, True), full.stderr
        loaded = labos("load", "sciclops.tower1", "--type", "plate96", "--count", "2", "--lot", "L7", *user)
        assert loaded.stdout == "2 × plate96 of lot L7 loaded at sciclops.tower1.\n", loaded.stderr
        assert client.wait(waiting, timeout_s=60).status == "completed"
        (item,) = client.state()["labware"]
        assert item["variables"]["lot"] == "L7"
        left = stack(inventory(), "sciclops.tower1")
        assert left["contents"] == [{"type": "plate96", "lot": "L7", "count": 1}]
        gone = labos("unload", "sciclops.exchange", item["id"], *user)
        assert gone.stdout == f"Taken away from sciclops.exchange: {item['id']}.\n", gone.stderr
        assert client.state()["labware"] == []
        refill = ("replenish", "sealer", "foil", "--lot", "F2", "--expires", "2020-01-31", *user)
        refused = labos(*refill)
        assert (refused.returncode, "is full of foil" in refused.stderr) == (1, True), refused.stderr
        client.place("sealer.default", "plate96", "ada")
        assert client.wait(client.do("sealer", "seal", user="ada"), timeout_s=60).status == "completed"
        assert labos(*refill).stdout == "1 of foil put into sealer (lot F2).\n"
    foil = next(r for r in inventory()["resources"] if r["module"] == "rpl/sealer")
    assert foil["lots"][-1] == {"lot": "F2", "left": 1.0, "expires": "2020-01-31", "expired": True}
    shown_text = labos("inventory", *home)
    assert "F2: 1 (EXPIRED 2020-01-31)" in shown_text.stdout
    assert labos("unload", "wc.trash", *user).returncode == 2
    assert labos("unload", "sealer.default", "--all", *user).returncode == 0
    assert lab.interrupt() == 0
    assert lab.disagreements() == []
    assert "1 of foil put in (lot F2), good until 2020-01-31" in labos("log", *home).stdout
    until(lambda: "resource.replenished" in lab.types(), "it is in the log")


def test_a_hotel_is_loaded_from_its_lowest_free_shelf(lab: Up) -> None:
    lab.start_with("sciclops", "pf400", "sealer")
    home = ("--home", str(lab.home))
    user = (*home, "--user", "ada")
    assert labos("place", "wc.output.2", "plate96", *user).stdout == "P1 stands at wc.output.2.\n"
    loaded = labos("load", "wc.output", "--type", "pcr96", "--count", "2", *user)
    assert loaded.stdout == "2 × pcr96 loaded at wc.output: P2 at wc.output.1, P3 at wc.output.3.\n", loaded
    assert labos("place", "wc.output", "plate96", *user).stdout == "P4 stands at wc.output.4.\n"
    full = labos("load", "wc.output", "--type", "pcr96", "--count", "11", *user)
    assert (full.returncode, "Load 10 at most." in full.stderr) == (1, True), full.stderr
    shown = labos("stations", "wc", "--occupied", *home).stdout.splitlines()
    assert [line.split()[0] for line in shown[2:]] == ["wc.output", *(f"wc.output.{n}" for n in (1, 2, 3, 4))]
    assert "4 on 14 shelves" in shown[2]
    with lab.client() as client:
        args = {"source": "wc.output.2", "target": "sealer.default"}
        with pytest.raises(LabosError, match=r"is a shelf of wc\.output"):
            client.do("pf400", "transfer", args, user="ada")
        run = client.do("pf400", "transfer", {**args, "source": "wc.output"}, user="ada")
        assert client.wait(run, timeout_s=60).status == "completed"
    assert labos("unload", "wc.output", "P2", *user).stdout == "Taken away from wc.output: P2.\n"
    gone = labos("unload", "wc.output", "--all", *user)
    assert gone.returncode == 0, gone.stderr
    with lab.client() as client:
        assert [item["station"] for item in client.state()["labware"]] == ["sealer.default"]
    assert lab.interrupt() == 0
    assert lab.disagreements() == []
