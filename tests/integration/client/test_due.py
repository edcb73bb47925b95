"""A run with a due date, by client and command line, in a lab that runs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.bootstrap import LabThread, descriptions
from labos.cli.explain import command as explain
from labos.cli.forecast import command as forecast
from labos.cli.runs import command as runs
from labos.cli.submit import command as submit
from labos.client import LabClient
from labos.errors import BadInput, KeyReused
from labos.settings import Settings
from labos.spec import parse_workcell
from tests.support.lab_process import until

CELL = """
labos: 1
name: shop
modules:
  - name: saw
    about: {actions: {cut: {duration: 3600}}}
"""
CUT = {
    "name": "cut.yaml",
    "text": "labos: 1\nname: cut\nsteps:\n  - {name: cut, module: saw, action: cut}\n",
    "files": {},
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    settings = Settings.make(tmp_path_factory.mktemp("due") / "lab", simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())]) as running:
        yield running


@pytest.mark.slow
def test_a_run_is_due_and_the_lab_says_whether_that_will_be_kept(lab: LabThread, tmp_path: Path) -> None:
    home = str(lab.settings.home)
    (tmp_path / "cut.yaml").write_text(CUT["text"])  # type: ignore[arg-type]
    with LabClient(lab.url) as client:
        until(lambda: client.state()["modules"][0]["status"] == "IDLE", "the saw is there", 60.0)
        client.control("pause", "lab", "ada")
        late = client.submit(CUT, user="ada", due="30 min", request="first")
        assert client.submit(CUT, user="ada", due="30 min", request="first") == late
        with pytest.raises(KeyReused):
            client.submit(CUT, user="ada", due="40 min", request="first")
        with pytest.raises(BadInput, match="has passed"):
            client.submit(CUT, user="ada", due="2020-01-01T08:00")
        with pytest.raises(BadInput, match="is not a time"):
            client.submit(CUT, user="ada", due="tomorrow")
        there = time.strftime("%Y-%m-%dT%H:%M", time.localtime(time.time() + 9 * 3600))
        arguments = [str(tmp_path / "cut.yaml"), "--user", "ada", "--due", there, "--home", home]
        kept = CliRunner().invoke(submit, arguments, catch_exceptions=False).stdout.strip()
        view = {run["id"]: run for run in client.state()["runs"]}
        assert view[late]["late_by_s"] == pytest.approx(1800, abs=60)
        assert view[kept]["due_at"] == int(time.mktime(time.strptime(there, "%Y-%m-%dT%H:%M"))) * 10**9
        assert client.status(late).due_at == view[late]["due_at"]
        client.control("resume", "lab", "ada")
        asked = client.forecast_run(CUT, user="ada", due="90 min")["forecast"]
        assert next(run for run in asked["runs"] if run["run"] in asked["new"])["late_by_s"] > 1790
    told = CliRunner().invoke(forecast, ["--home", home], catch_exceptions=False).stdout
    assert "late by about" in told
    assert "kept, with about" in told or "may be late" in told
    listed = CliRunner().invoke(runs, ["--home", home], catch_exceptions=False).stdout
    assert "late by about 30 min" in listed
    alone = CliRunner().invoke(explain, [late, "--home", home], catch_exceptions=False).stdout
    assert "it is due at" in alone
    as_data = CliRunner().invoke(runs, ["--home", home, "--json"], catch_exceptions=False).stdout
    assert [("late by" in run["due"]) for run in json.loads(as_data)] == [True, False]


CAMPAIGN = """
labos: 1
campaign: cuts
workflow: cut.yaml
due: ready_by
rows:
  list:
    - {ready_by: 2099-05-04T10:30}
    - {ready_by: "2099-05-03T10:30Z"}
    - {}
"""


@pytest.mark.slow
def test_rows_of_a_campaign_are_due(lab: LabThread, tmp_path: Path) -> None:
    (tmp_path / "cut.yaml").write_text(CUT["text"])
    (tmp_path / "cuts.yaml").write_text(CAMPAIGN)
    with LabClient(lab.url) as client:
        before = {run["id"] for run in client.state()["runs"]}
        campaign = client.submit_campaign(tmp_path / "cuts.yaml", user="ada")
        until(lambda: len(_runs_beside(client, before)) == 3, "the rows are runs", 60.0)
        due = [run["due_at"] for run in _runs_beside(client, before)]
        there = int(time.mktime(time.strptime("2099-05-04T10:30", "%Y-%m-%dT%H:%M"))) * 10**9
        assert due == [there, 4081487400 * 10**9, 0]
        (tmp_path / "cuts.yaml").write_text(CAMPAIGN.replace("2099-05-04T10:30", "soon"))
        with pytest.raises(BadInput, match="Row 1: 'soon' is not a time"):
            client.submit_campaign(tmp_path / "cuts.yaml", user="ada")
        again = client.clone_campaign(campaign["campaign"], "ada")
        assert again["campaign"] != campaign["campaign"]


def _runs_beside(client: LabClient, before: set[str]) -> list[dict[str, Any]]:
    return [run for run in client.state()["runs"] if run["id"] not in before]
