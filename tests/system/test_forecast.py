"""Forecasts over HTTP and on the command line: of the queue, of a run and of a campaign not submitted yet."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import group
from labos.client import LabClient
from labos.core.lengths import find_drifts
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import until

CELL = """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: sealer, model: A4S_sealer, resources: {foil: 3}}
stations:
  wc.trash: {kind: waste, capacity: 50}
stock:
  left.tower1: {plate96: 10}
"""
FLOW = """
labos: 1
name: seal
steps:
  - {name: get, module: left, action: get_plate, args: {loc: tower1}}
  - {name: in, module: ur, action: transfer, args: {source: left.exchange, target: sealer.default}}
  - {name: seal, module: sealer, action: seal, args: {time: payload.time}}
  - {name: out, module: ur, action: transfer, args: {source: sealer.default, target: wc.trash}}
"""


class Home:
    """A lab at real speed whose nodes have joined, and the files of a campaign."""

    def __init__(self, lab: LabThread, folder: Path) -> None:
        self.lab, self.flow = lab, folder / "seal.yaml"
        self.campaign = folder / "screen.yaml"
        self.flow.write_text(FLOW)
        rows = "[{time: 1}, {time: 2}, {time: 3}, {time: 4}]"
        self.campaign.write_text(
            f"labos: 1\ncampaign: screen\nworkflow: seal.yaml\ndeadline: 1m\nrows: {{list: {rows}}}\n"
        )

    def __call__(self, *words: str) -> Result:
        return CliRunner().invoke(group, [*words, "--home", str(self.lab.settings.home)])


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Home]:
    folder = tmp_path_factory.mktemp("lab")
    (folder / "cell.yaml").write_text(CELL)
    cell = load_workcell(folder / "cell.yaml", descriptions())
    settings = Settings.make(folder / "home", speed=1.0, simulate=True)
    with LabThread(settings, [cell], nodes="processes") as running, LabClient(running.url) as client:
        until(lambda: all(node["status"] == "IDLE" for node in client.state()["modules"]), "all nodes idle")
        yield Home(running, folder)


@pytest.mark.slow
def test_what_is_not_submitted_is_forecast_and_leaves_no_trace(home: Home) -> None:
    with LabClient(home.lab.url) as client:
        before = client.health()["position"]
        told = json.loads(home("campaign", "plan", str(home.campaign), "--json").output)
        run = home("run", str(home.flow), "--payload", "time=2", "--dry-run")
        assert client.health()["position"] == before
    forecast = told["forecast"]
    (found,) = forecast["campaigns"]
    assert (found["rows_left"], found["rows_forecast"], len(forecast["new"])) == (4, 4, 4)
    assert told["consumables"]["foil"] == {"needed": 4, "left": 3}
    assert any("foil" in touch["why"] for touch in forecast["touches"])
    assert any("deadline" in conflict for conflict in forecast["conflicts"])
    assert [each["ends"] is None for each in forecast["runs"]] == [False, False, False, True]
    assert run.exit_code == 0
    assert "ends:        about " in run.output
    assert "delays:      nobody" in run.output


@pytest.mark.slow
def test_a_forecast_takes_labware_that_would_be_placed(home: Home) -> None:
    flow = "labos: 1\nname: one\nsteps:\n  - {name: seal, module: sealer, action: seal, args: {time: 2}}\n"
    one = home.flow.with_name("one.yaml")
    one.write_text(flow)
    placed = home("run", str(one), "--place", "sealer.default=plate96", "--dry-run")
    assert placed.exit_code == 0, placed.output
    assert "ends:        about " in placed.output
    with LabClient(home.lab.url) as client:
        same = client.forecast_run(one, user="ada", place=[("sealer.default", "plate96")])["forecast"]
        assert same["runs"][-1]["ends"] is not None
        bare = client.forecast_run(one, user="ada")["forecast"]
        assert bare["runs"][-1]["ends"] is None, "there is no plate to seal"


@pytest.mark.slow
def test_what_waits_for_an_approval_is_forecast_as_if_it_were_given(home: Home) -> None:
    name = home("campaign", "submit", str(home.campaign), "--propose", "--user", "ada").stdout.strip()
    told = json.loads(home("approvals", name, "--json").output)["forecast"]
    forecast = told["forecast"]
    (found,) = (each for each in forecast["campaigns"] if each["campaign"] == name)
    starts = found["starts"]
    assert starts["earliest_at"] <= starts["expected_at"] <= starts["latest_at"]
    assert (found["rows_left"], found["rows_forecast"], len(forecast["new"])) == (4, 4, 4)
    assert told["consumables"]["foil"] == {"needed": 4, "left": 3}
    assert any("deadline" in conflict for conflict in forecast["conflicts"])
    with LabClient(home.lab.url) as client:
        queue = client.forecast()["forecast"]
        assert not [run for run in queue["runs"] if run["campaign"] == name], "it waits"
    assert home("refuse", name).exit_code == 0


@pytest.mark.slow
def test_the_queue_shows_when_runs_start_and_end(home: Home) -> None:
    names = [home("submit", str(home.flow), "--payload", "time=2").output.split()[0] for _ in range(2)]
    told = json.loads(home("forecast", "--json").output)["forecast"]
    known = {run["run"]: run for run in told["runs"]}
    assert set(names) <= set(known)
    assert known[names[0]]["ends"]["expected_at"] < known[names[1]]["ends"]["expected_at"]
    text = home("forecast").output
    assert "about " in text
    assert names[1] in text
    delayed = home("run", str(home.flow), "--payload", "time=2", "--priority", "9", "--dry-run").output
    assert f"delays:      {names[1]} of " in delayed
    with LabClient(home.lab.url) as client:
        urgent = client.submit(home.flow, {"time": 2}, user="ada", priority=9, propose=True)
    shown = home("approvals", urgent).output
    for word in (
        "Forecast for an approval now:",
        "starts:      about",
        "uses up:     1 foil",
        "delays:      ",
    ):
        assert word in shown, shown


@pytest.mark.slow
def test_how_good_forecasts_were_is_learned_from_the_log_alone(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "seal.yaml").write_text(FLOW)
    cell = load_workcell(tmp_path / "cell.yaml", descriptions())
    settings = Settings.make(tmp_path / "home", speed=2000.0, simulate=True)

    def carry_out(client: LabClient, count: int) -> None:
        until(lambda: all(node["status"] == "IDLE" for node in client.state()["modules"]), "all nodes idle")
        for _ in range(count):
            client.submit(tmp_path / "seal.yaml", {"time": 2}, user="ada")
        until(lambda: not client.state()["runs"], "all runs ended")

    with LabThread(settings, [cell], nodes="processes") as running, LabClient(running.url) as client:
        assert client.forecast()["forecast"]["learned_from"] == 0
        carry_out(client, 2)
        assert client.forecast()["forecast"]["learned_from"] == 2
        client.submit(tmp_path / "seal.yaml", {"time": 600}, user="ada")
        told = CliRunner().invoke(group, ["forecast", "--home", str(tmp_path / "home")]).output
        assert "the width of the ranges is partly assumed" in told
        carry_out(client, 0)
        assert client.forecast()["forecast"]["learned_from"] == 3, "only what came since is read"
        state = running.runtime.kernel.state
        drifts = client.forecast()["drifts"]
        assert drifts == msgspec.to_builtins(find_drifts(state.lengths, state.lab.pace)), (
            "as the doctor has them"
        )
    with LabThread(settings, [cell], nodes="none") as again, LabClient(again.url) as client:
        assert client.forecast()["forecast"]["learned_from"] == 3, "it is read again"
