"""Campaigns over HTTP and on the command line: checked as a whole, submitted, controlled, reported."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import group
from labos.client import LabClient
from labos.errors import BadInput, NotFound, Refused
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.support.lab_process import until

CAMPAIGN = "labos: 1\ncampaign: sealing\nworkflow: pcr\nrows: {table: rows.csv}\n"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def client(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url) as found:
        yield found


def write_campaign(folder: Path, rows: str, more: str = "") -> Path:
    (folder / "rows.csv").write_text(f"seal.time\n{rows}")
    path = folder / "screen.yaml"
    path.write_text(CAMPAIGN + more)
    return path


def labos(lab: LabThread, *words: str) -> Result:
    where = ["--home", str(lab.settings.home)]
    return CliRunner().invoke(group, [*words, *where])


def test_nothing_is_submitted_if_a_row_is_wrong(client: LabClient, tmp_path: Path) -> None:
    before = client.health()["position"]
    with pytest.raises(BadInput) as error:
        client.submit_campaign(write_campaign(tmp_path, "1\nhot\n3\ncold\n"), user="ada")
    assert "rows.csv:3:1: steps[1].args.time (Seal plate/Seal): Row 2:" in str(error.value)
    assert "rows.csv:5:1: steps[1].args.time (Seal plate/Seal): Row 4:" in str(error.value)
    assert "Write a number from 0 to 999.9 s" in str(error.value)
    assert client.health()["position"] == before


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("until: steps.Sea.result.x > 1\n", "screen.yaml:5:8: until: The workflow has no step 'Sea'."),
        ("deadline: 2020-01-01T00:00Z\n", "deadline: The deadline has passed."),
        ("deadline: soon\n", "'soon' is not a time."),
    ],
)
def test_what_only_the_lab_can_know(client: LabClient, tmp_path: Path, more: str, said: str) -> None:
    with pytest.raises(BadInput) as error:
        client.submit_campaign(write_campaign(tmp_path, "1\n", more), user="ada", dry_run=True)
    assert said in str(error.value)


def test_a_few_runs_wait_and_the_rest_stay_rows(client: LabClient, tmp_path: Path) -> None:
    told = client.submit_campaign(
        write_campaign(tmp_path, "1\n" * 20, "deadline: 12h\ntags: [x]\n"), user="ada"
    )
    name = told["campaign"]
    assert told["estimate"]["consumables"]["tips"]["needed"] == 480
    until(lambda: client.campaign(name)["queued"] == 4, "four wait")
    assert client.campaign(name)["left"] == 16
    client.pause_campaign(name, "ada", why="tea")
    assert client.campaign(name)["status"] == "paused"
    client.resume_campaign(name, "ada")
    terms = client.amend_campaign(name, "ada", priority=3, deadline="", stop_after=2)
    assert (terms["priority"], terms["deadline"], terms["stop_after"], terms["tags"]) == (3, 0, 2, ["x"])
    client.cancel_campaign(name, "ada", why="wrong plates")
    with pytest.raises(NotFound, match="has not ended"):
        client.campaign(name)
    assert name not in [item["id"] for item in client.campaigns()]


def test_one_key_is_one_campaign(client: LabClient, tmp_path: Path) -> None:
    path = write_campaign(tmp_path, "1\n2\n")
    names = {client.submit_campaign(path, user="ada", request="key")["campaign"] for _ in range(3)}
    assert len(names) == 1
    with pytest.raises(Refused, match="which has other rows"):
        client.submit_campaign(write_campaign(tmp_path, "1\n3\n"), user="ada", request="key")
    client.cancel_campaign(names.pop(), "ada")


def test_the_command_line(lab: LabThread, tmp_path: Path) -> None:
    path = str(write_campaign(tmp_path, "1\n2\n", "budget: {runs: 9}\n"))
    assert "2 rows of pcr in rpl" in labos(lab, "campaign", "plan", path).output
    name = labos(lab, "campaign", "submit", path, "--user", "ada").output.strip()
    paused = labos(lab, "campaign", "pause", name, "--why", "tea")
    assert (paused.exit_code, paused.stdout) == (0, f"{name} is paused.\n")
    shown = json.loads(labos(lab, "campaign", "show", name, "--json").output)
    assert (shown["status"], shown["rows"], shown["user"]) == ("paused", 2, "ada")
    assert "most runs" in labos(lab, "campaign", "show", name).output
    assert labos(lab, "campaign", "resume", name).exit_code == 0
    until(lambda: json.loads(labos(lab, "campaign", "report", name, "--json").output), "a row is submitted")
    amended = labos(lab, "campaign", "amend", name, "--runs", "1", "--lab-time", "2 h", "--json")
    assert json.loads(amended.output)["budget"]["lab_time_s"] == 7200.0
    assert labos(lab, "campaign", "cancel", name).exit_code == 0
    assert f"{name} " in labos(lab, "campaign", "list", "--all").output
    report = labos(lab, "campaign", "report", name, "--csv").output.splitlines()
    assert report[0].startswith("row,run,status,took,seal.time")
    assert isinstance(labos(lab, "campaign", "show", "C99").exception, NotFound)


def test_one_is_cloned_and_archived(lab: LabThread, client: LabClient, tmp_path: Path) -> None:
    path = write_campaign(tmp_path, "1\n2\n3\n", "budget: {runs: 9}\ntags: [x]\ndeadline: 90h\n")
    first = str(client.submit_campaign(path, user="ada")["campaign"])
    labos(lab, "campaign", "amend", first, "--runs", "7")
    early = labos(lab, "campaign", "archive", first)
    assert isinstance(early.exception, Refused)
    assert "has not ended" in str(early.exception)
    client.cancel_campaign(first, "ada")
    until(lambda: all(c["id"] != first for c in client.campaigns()), "it has ended")
    checked = labos(lab, "campaign", "clone", first, "--dry-run")
    assert checked.stdout == "3 rows of pcr can be carried out.\n"
    again = labos(lab, "campaign", "clone", first, "--user", "bo", "--name", "once more", "--priority", "2")
    name = again.stdout.strip()
    told = client.campaign(name)
    assert (told["rows"], told["user"], told["name"], told["cloned_from"]) == (3, "bo", "once more", first)
    terms = told["terms"]
    assert (terms["priority"], terms["budget"]["runs"], terms["tags"], terms["deadline"]) == (2, 7, ["x"], 0)
    shown = labos(lab, "campaign", "show", name).output
    assert any(line.split() == ["clone", "of", first] for line in shown.splitlines())
    rows = {row: json.loads(labos(lab, "campaign", "show", row, "--json").output) for row in (first, name)}
    assert rows[first]["table"] == rows[name]["table"]
    assert rows[first]["definition"] == rows[name]["definition"]
    # The same key twice is one clone.
    twice = {client.clone_campaign(first, "bo", request="again")["campaign"] for _ in range(2)}
    assert len(twice) == 1
    with pytest.raises(NotFound, match="C99"):
        client.clone_campaign("C99", "bo")
    for clone in (name, *twice):
        client.cancel_campaign(clone, "bo")
    assert labos(lab, "campaign", "archive", first).stdout == f"{first} is archived.\n"
    assert f"{first} " not in labos(lab, "campaign", "list", "--all").output
    listed = json.loads(labos(lab, "campaign", "list", "--all", "--archived", "--json").output)
    assert [c["archived"] for c in listed if c["id"] == first] == [True]
    assert labos(lab, "campaign", "archive", first, "--undo").exit_code == 0
    assert f"{first} " in labos(lab, "campaign", "list", "--all").output


def test_shares_are_applied_and_shown(lab: LabThread, client: LabClient, tmp_path: Path) -> None:
    path = tmp_path / "shares.yaml"
    path.write_text("labos: 1\ngroups: {chem: {weight: 3.0, members: {ada: {}}}}\nusers: {eve: {}}\n")
    shown = labos(lab, "shares", "--apply", str(path))
    assert shown.exit_code == 0, shown.output
    accounts = {account["user"]: account for account in client.shares()}
    assert accounts["ada"]["group"] == "chem"
    assert accounts["ada"]["wanted"] == pytest.approx(3 * accounts["eve"]["wanted"])
    assert "chem" in labos(lab, "shares").output


@pytest.mark.slow
def test_each_row_is_carried_out_and_reported(tmp_path: Path) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    more = 'until: steps["Take picture"].result.bytes > 1\n'
    with LabThread(settings, [cell], nodes="processes") as lab, LabClient(lab.url) as client:
        name = client.submit_campaign(write_campaign(tmp_path, "1\n2\n3\n4\n5\n6\n", more), user="ada")[
            "campaign"
        ]
        until(lambda: not client.campaigns(), "its stop rule ends it", 100.0)
        rows = json.loads(labos(lab, "campaign", "report", name, "--json").output)
        shown = json.loads(labos(lab, "campaign", "show", name, "--json").output)
    assert shown["status"] == "stopped"
    assert "Its stop rule holds for R1" in shown["why"]
    assert rows[0]["status"] == "completed"
    assert rows[0]["results"]["Take picture"]["bytes"] > 1
    assert [row["payload"]["seal"]["time"] for row in rows] == list(range(1, len(rows) + 1))
