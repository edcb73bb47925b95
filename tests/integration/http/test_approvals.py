"""Approvals from outside: what waits, what is shown of it, what is approved; on the command line, too."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from labos.bootstrap import LabThread
from labos.cli.app import group
from labos.client import LabClient
from labos.core.decide.users import AddUser, GrantRole
from labos.errors import BadInput, Forbidden, NotFound, Refused
from tests.integration.http.signed import execute, lab_with_users, token_of

SEAL = (
    "labos: 1\nname: seal\nsteps:\n"
    "  - {name: seal it, module: sealer, action: seal, args: {time: payload.time, temperature: 175}}\n"
)
CAMPAIGN = (
    "labos: 1\ncampaign: times\nworkflow: seal.yaml\nbudget: {runs: 9}\n"
    "rows: {list: [{time: 1}, {time: 2}, {time: 3}]}\n"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("approvals")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        execute(running, AddUser("olga"), "ada")
        execute(running, GrantRole("user:olga", "operator", "rpl"), "ada")
        yield running


class People(dict[str, LabClient]):
    """A client of each."""

    def __init__(self, lab: LabThread, folder: Path) -> None:
        super().__init__()
        self.tokens = {
            name: token_of(folder, name, scope="admin") for name in ("ada", "bob", "olga", "agent")
        }
        for name, token in self.tokens.items():
            self[name] = LabClient(lab.url, token=token)
        self.url = lab.url

    def labos(self, user: str, *words: str, code: int = 0) -> Result:
        env = {"LABOS_URL": self.url, "LABOS_TOKEN": self.tokens[user], "LABOS_HOME": ""}
        result = CliRunner().invoke(group, words, env=env)
        assert result.exit_code == code, result.output + repr(result.exception)
        return result

    def seal(self, user: str, text: str = SEAL, **options: Any) -> str:
        payload = options.pop("payload", {"time": 3})
        return self[user].submit({"text": text, "name": "seal.yaml"}, payload, user="", **options)

    def screen(self, user: str, text: str = CAMPAIGN, **options: Any) -> dict[str, Any]:
        told = {"text": text, "name": "c.yaml", "workflow": {"text": SEAL, "name": "seal.yaml"}}
        return self[user].submit_campaign(told, user="", **options)


@pytest.fixture(scope="module")
def people(lab: LabThread, folder: Path) -> Iterator[People]:
    found = People(lab, folder)
    yield found
    for client in found.values():
        client.close()


def test_a_submission_that_waits_says_so_and_is_approved_as_it_was_seen(people: People) -> None:
    first = people.seal("agent")
    assert people["agent"].approval == (
        f"{first} waits for approval, because it was made by a program (agent). An operator answers: "
        f"labos approve {first}"
    )
    shown = people["bob"].approval_of(first)
    assert (shown["proposal"]["before"], shown["differences"]) == ("", [])
    assert shown["proposal"]["demand"]["modules"] == {"sealer": shown["proposal"]["demand"]["module_time_s"]}
    with pytest.raises(Forbidden, match="operator"):
        people["bob"].approve(first, "", shown["proposal"]["digest"])
    with pytest.raises(Refused, match="has changed since you checked it"):
        people["olga"].approve(first, "", "ab" * 32)
    people["olga"].approve(first, "", shown["proposal"]["digest"], comment="good")
    with pytest.raises(NotFound, match="does not wait"):
        people["olga"].approval_of(first)
    # The same again with other values and another text: what has changed is shown.
    second = people.seal("agent", SEAL.replace("175", "180"), payload={"time": 4})
    shown = people["olga"].approval_of(second)
    assert shown["proposal"]["before"] == first
    changed = {found["part"]: found["lines"] for found in shown["differences"]}
    assert changed["payload"] == ["time: 3 -> 4"]
    assert any(line.startswith("-") and "175" in line for line in changed["workflow"])
    assert any(line.startswith("+") and "180" in line for line in changed["workflow"])
    people["olga"].refuse(second, "", comment="too hot")
    assert people["olga"].status(second).why == "olga did not approve it: too hot"


def test_on_the_command_line(people: People, tmp_path: Path) -> None:
    assert "Nothing waits" in people.labos("olga", "approvals").output
    several = [people.seal("agent") for _ in range(3)]
    page = people["bob"]._get("/approvals", {"limit": 2})
    assert ([p["subject"] for p in page["approvals"]], page["more"]) == (several[:2], True)
    page = people["bob"]._get("/approvals", {"limit": 2, "after": several[1]})
    assert ([p["subject"] for p in page["approvals"]], page["more"]) == (several[2:], False)
    for name in several:
        people["agent"].cancel(name)
    run = people.seal("agent")
    listed = people.labos("bob", "approvals").output
    assert "labos approvals ID; answer: labos approve ID" in listed
    assert "it was made by a program (agent)" in listed
    shown = people.labos("bob", "approvals", run).output
    assert "module time" in shown
    assert "approved before" in shown
    digest = json.loads(people.labos("bob", "approvals", run, "--json").output)["proposal"]["digest"]
    assert people.labos("olga", "approve", run, "--digest", "0" * 64, code=1)
    told = json.loads(people.labos("olga", "approve", run, "--why", "fine", "--json").output)
    assert told == {"subject": run, "approved": True, "digest": digest}
    held = people.seal("agent")
    assert f"{held} is refused." in people.labos("olga", "refuse", held).output
    log = people.labos("ada", "log", "--type", "approval").output
    assert f"approved by olga ({digest[:12]}): fine" in log
    # A submission of a person who asks for it; its answer says what it waits for.
    (tmp_path / "seal.yaml").write_text(SEAL)
    told_run = people.labos("bob", "submit", str(tmp_path / "seal.yaml"), "--payload", "time=3", "--propose")
    assert "waits for approval, because bob requests it" in told_run.output
    assert "Check it" in people.labos("olga", "interventions").output
    people.labos("olga", "refuse", told_run.stdout.split()[-1])


def test_a_campaign_is_approved_with_changes_and_enlarged_only_by_another_approval(people: People) -> None:
    told = people.screen("agent")
    name = told["campaign"]
    assert "waits for approval" in told["approval"]
    assert people["bob"].campaign(name)["status"] == "proposed"
    demand = people["olga"].approval_of(name)["proposal"]["demand"]
    assert (demand["rows"], demand["steps"]) == (3, 3)
    people.labos("olga", "approve", name, "--runs", "2", "--priority", "1", "--why", "two are enough")
    terms = people["bob"].campaign(name)["terms"]
    assert (terms["budget"]["runs"], terms["priority"]) == (2, 1)
    terms = people["agent"].amend_campaign(name, "", runs=3)
    assert terms["budget"]["runs"] == 2, "it goes on as it was approved"
    assert f"The change of {name} waits for approval" in people["agent"].approval
    shown = people["olga"].approval_of(name)
    assert shown["differences"][0]["lines"] == ["budget.runs: 2 -> 3"]
    assert "budget.runs: 2 -> 3" in people.labos("olga", "approvals", name).output
    people["olga"].approve(name, "", shown["proposal"]["digest"])
    assert people["bob"].campaign(name)["terms"]["budget"]["runs"] == 3
    people["agent"].cancel_campaign(name, "")


@pytest.mark.slow
def test_what_a_proposal_would_bring_is_shown_before_it_is_approved(people: People, lab: LabThread) -> None:
    run = people.seal("agent")
    before = lab.runtime.kernel.state.position
    told = json.loads(people.labos("olga", "approvals", run, "--json").output)["forecast"]
    assert lab.runtime.kernel.state.position == before
    (expected,) = (found for found in told["forecast"]["runs"] if found["run"] == run)
    assert told["forecast"]["new"] == [run]
    assert expected["ends"] is None, "no node is there"
    assert any("sealer is unavailable" in conflict for conflict in told["forecast"]["conflicts"])
    assert told["consumables"]["foil"]["needed"] == 1
    shown = people.labos("olga", "approvals", run).output
    for word in (
        "Forecast for an approval now",
        "starts:      ",
        "uses up:     1 foil",
        "person:",
        "delays:",
    ):
        assert word in shown, shown
    assert "Forecast for" not in people.labos("olga", "approvals", run, "--no-forecast").output
    name = people.screen("agent")["campaign"]
    found = people["bob"].approval_forecast(name)
    (campaign,) = (each for each in found["forecast"]["campaigns"] if each["campaign"] == name)
    assert campaign["rows_left"] == 3
    assert found["consumables"]["foil"]["needed"] == 3
    # A change of a campaign that goes on.
    people.labos("olga", "approve", name, "--runs", "2")
    people["agent"].amend_campaign(name, "", runs=3)
    assert people["bob"].approval_forecast(name)["forecast"]["refusal"] == ""
    experiment = people["agent"].start_experiment("app", "")
    with pytest.raises(BadInput, match="There is no forecast"):
        people["bob"].approval_forecast(experiment)
    assert "Forecast for" not in people.labos("olga", "approvals", experiment).output
    people["agent"].end_experiment(experiment)
    people["agent"].cancel_campaign(name, "")
    people["agent"].cancel(run)


def test_an_experiment_of_a_program_waits(people: People) -> None:
    name = people["agent"].start_experiment("app", "")
    assert people["agent"].approval.startswith(f"{name} waits for approval")
    run = people.seal("agent", experiment=name)
    shown = people["olga"].approval_of(name)["proposal"]
    with pytest.raises(Refused, match="Approve that first"):
        people["olga"].approve(run, "", people["olga"].approval_of(run)["proposal"]["digest"])
    people["olga"].approve(name, "", shown["digest"])
    people.labos("olga", "approve", run, "--alike")
    other = people.seal("agent", experiment=name, payload={"time": 5})
    assert people["agent"].approval == ""
    people["agent"].cancel(run)
    people["agent"].cancel(other)
    people["agent"].end_experiment(name)


def test_another_file_that_a_workflow_uses_is_another_workflow(people: People) -> None:
    """Its own text is the same, and so may be its name."""
    outer = "labos: 1\nname: outer\nsteps:\n  - {name: inside, use: inner.yaml}\n"

    def propose(temperature: str, experiment: str) -> str:
        inner = SEAL.replace("175", temperature)
        text = {"text": outer, "name": "o.yaml", "files": {"inner.yaml": b64encode(inner.encode()).decode()}}
        return people["agent"].submit(text, {"time": 3}, user="", experiment=experiment)

    name = people["agent"].start_experiment("files", "")
    people.labos("olga", "approve", name)
    first = propose("175", name)
    people.labos("olga", "approve", first, "--alike")
    again = propose("175", name)
    assert people["agent"].approval == ""
    other = propose("180", name)
    assert "waits for approval" in people["agent"].approval
    (changed,) = people["olga"].approval_of(other)["differences"]
    assert changed["part"] == "file:inner.yaml"
    assert any("175" in line and line.startswith("-") for line in changed["lines"])
    people.labos("olga", "refuse", other)
    for run in (first, again):
        people["agent"].cancel(run)
    people["agent"].end_experiment(name)


def test_the_policy_is_a_file_that_an_admin_applies(people: People, tmp_path: Path) -> None:
    assert "No policy was set" in people.labos("bob", "policy").output
    file = tmp_path / "policy.yaml"
    file.write_text(
        "labos: 1\ntrusted: [agent]\nnewcomers: 1\nabove: {lab_time: 1 h}\npriority: 0\n"
        "bookings: {hours: 12, days_ahead: 30}\n"
    )
    with pytest.raises(Forbidden, match="admin"):
        people["olga"].apply_policy(file.read_text(), "policy.yaml", "")
    shown = people.labos("ada", "policy", "--apply", str(file)).output
    for said in (
        "not those of agent",
        "the first 1 submissions of each user",
        "1 h",
        "highest priority",
        "12 h each",
    ):
        assert said in shown
    assert people["bob"].policy()["policy"]["newcomers"] == 1
    people["agent"].cancel(people.seal("agent"))
    assert people["agent"].approval == ""
    run = people.seal("bob")
    assert "bob is new here" in people["bob"].approval
    with pytest.raises(Refused, match=r"priority 1 is above 0"):
        people.seal("bob", priority=1)
    people["olga"].refuse(run, "")
    with pytest.raises(BadInput, match=r"p\.yaml:2:12: newcomers"):
        people["ada"].apply_policy("labos: 1\nnewcomers: many\n", "p.yaml", "")
    with pytest.raises(BadInput, match=r"p\.yaml:3:1: trusted"):
        people["ada"].apply_policy("labos: 1\nprograms: false\ntrusted: [x]\n", "p.yaml", "")
    people["ada"].apply_policy("labos: 1\n", "p.yaml", "")


def test_shares_say_how_high_a_priority_may_be(people: People) -> None:
    text = "labos: 1\ngroups: {chemistry: {members: {bob: {}}, quota: {priority: 2}}}\n"
    people["ada"].apply_shares(text, "shares.yaml", "")
    run = people.seal("bob", priority=2)
    people["bob"].cancel(run)
    with pytest.raises(Refused, match="above 2, which is the highest for the group chemistry"):
        people.screen("bob", CAMPAIGN + "priority: 3\n")
    people["ada"].apply_shares("labos: 1\n", "shares.yaml", "")


def test_what_a_run_would_be_is_told_without_submitting_it(people: People, lab: LabThread) -> None:
    before = lab.runtime.kernel.state.position
    told = people["bob"].check({"text": SEAL, "name": "s.yaml"}, payload={"time": 3})
    assert (told["approval"], told["refusal"], told["steps"][0]["key"]) == ([], "", "seal it")
    told = people["agent"].check({"text": SEAL, "name": "s.yaml"}, payload={"time": 3})
    assert told["approval"] == ["it was made by a program (agent)"]
    execute(lab, AddUser("vic"), "ada")
    before += 1
    told = people["bob"].check({"text": SEAL, "name": "s.yaml"}, payload={"time": 3}, experiment="E99")
    assert "E99 is not open" in told["refusal"]
    with pytest.raises(BadInput, match="time"):
        people["bob"].check({"text": SEAL, "name": "s.yaml"})
    assert lab.runtime.kernel.state.position == before


def test_a_terminal_obeys_nothing_that_was_proposed(people: People) -> None:
    before = people.seal("agent")
    people["olga"].approve(before, "", people["olga"].approval_of(before)["proposal"]["digest"])
    evil = SEAL + "# \u202e clears your screen\n"
    run = people.seal("agent", evil)
    shown = people.labos("olga", "approvals", run).output
    assert "clears your screen" in shown
    assert not any(char in shown for char in ("\u202e", "\x1b"))
    people["olga"].refuse(run, "")
