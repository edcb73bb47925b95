"""Campaigns that not everybody sees: who sees them, and where they are kept back from others."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner, Result

from labos.bootstrap import ApiSettings, LabThread
from labos.cli.app import group
from labos.client import LabClient
from labos.core.decide.users import AddUser, GrantRole
from labos.errors import NotFound
from labos.settings import Settings
from tests.integration.http.signed import client_of, execute, lab_with_users, token_of
from tests.support.api_process import ApiThread
from tests.support.lab_process import until

SEAL = (
    "labos: 1\nname: secret seal\nsteps:\n"
    "  - {name: seal it, module: sealer, action: seal, args: {time: payload.time}}\n"
)
SHARES = "labos: 1\ngroups: {chemistry: {members: {bob: {}, cleo: {}}}, physics: {members: {eve: {}}}}\n"
SEES = {
    "lab": {"bob", "cleo", "eve", "olga", "otto", "ada", "agent"},
    "group": {"bob", "cleo", "olga", "ada"},
    "private": {"bob", "olga", "ada"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("visibility")


class People:
    """bob submits; cleo is of his group, eve of another; olga is operator of the workcell, otto of none."""

    def __init__(self, lab: LabThread, folder: Path) -> None:
        names = ("ada", "bob", "cleo", "eve", "olga", "otto", "agent")
        self.url, self.lab = lab.url, lab
        self.tokens = {name: token_of(folder, name, scope="admin") for name in names}
        self.clients = {name: LabClient(lab.url, token=token) for name, token in self.tokens.items()}

    def __getitem__(self, name: str) -> LabClient:
        return self.clients[name]

    def labos(self, user: str, *words: str) -> Result:
        env = {"LABOS_URL": self.url, "LABOS_TOKEN": self.tokens[user], "LABOS_HOME": ""}
        return CliRunner().invoke(group, words, env=env)

    def screen(self, visibility: str, name: str) -> str:
        text = (
            f"labos: 1\ncampaign: {name}\nworkflow: seal.yaml\nvisibility: {visibility}\n"
            "rows: {list: [{time: 1}, {time: 2}]}\n"
        )
        workflow = SEAL.replace("secret ", "") if visibility == "lab" else SEAL
        told = {"text": text, "name": "c.yaml", "workflow": {"text": workflow, "name": "seal.yaml"}}
        return str(self["bob"].submit_campaign(told, user="")["campaign"])

    def runs_of(self, campaign: str) -> list[str]:
        """Its runs, once there are some."""
        state = self.lab.runtime.kernel.state
        until(lambda: bool(state.campaigns.open[campaign].runs), "a row has become a run")  # type: ignore[index]
        return [str(run) for run in state.campaigns.open[campaign].runs]  # type: ignore[index]


@pytest.fixture(scope="module")
def people(folder: Path) -> Iterator[People]:
    with lab_with_users(folder) as running:
        for name, role, cell in (
            ("cleo", "submitter", "*"),
            ("eve", "submitter", "*"),
            ("olga", "operator", "rpl"),
            ("otto", "viewer", "*"),
        ):
            execute(running, AddUser(name), "ada")
            execute(running, GrantRole(f"user:{name}", role, cell), "ada")  # type: ignore[arg-type]
        found = People(running, folder)
        found["ada"].apply_shares(SHARES, "shares.yaml", "")
        yield found
        for client in found.clients.values():
            client.close()


def sees_nothing(text: str, campaign: str, runs: list[str]) -> None:
    for word in ("secret", f'"{campaign}"', *(f'"{run}"' for run in runs)):
        assert word not in text, (word, text[max(text.find(word) - 300, 0) : text.find(word) + 100])


@pytest.mark.parametrize("visibility", SEES)
def test_who_sees_a_campaign(people: People, visibility: str) -> None:
    name = people.screen(visibility, visibility if visibility == "lab" else f"secret {visibility}")
    runs = people.runs_of(name)
    for user, client in people.clients.items():
        sees = user in SEES[visibility]
        assert (name in [c["id"] for c in client.campaigns()]) is sees, user
        assert (runs[0] in [run["id"] for run in client.runs()["runs"]]) is sees, user
        assert (runs[0] in [run["id"] for run in client.state()["runs"]]) is sees, user
        assert any(e["payload"].get("campaign") == name for e in client.events()) is sees, user
        if sees:
            assert client.campaign(name)["visibility"] == visibility
            assert client.status(runs[0]).id == runs[0]
        else:
            for ask in (lambda c=client: c.campaign(name), lambda c=client: c.status(runs[0])):
                with pytest.raises(NotFound):
                    ask()
    people["bob"].cancel_campaign(name, "")
    until(lambda: name in people.lab.runtime.kernel.state.campaigns.ended, "it has ended")
    for user, client in people.clients.items():  # what has ended is kept back, too
        told = any(e["payload"].get("campaign") == name for e in client.events())
        assert told is (user in SEES[visibility]), user


@pytest.mark.slow
def test_nothing_of_a_private_one_is_told_to_others(people: People) -> None:
    name = people.screen("private", "secret screen")
    runs = people.runs_of(name)
    pages = (
        *("/campaigns", f"/campaigns/{name}", f"/campaigns/{name}/signatures"),
        *("/runs?ended=50", f"/runs/{runs[0]}", f"/runs/{runs[0]}/signatures"),
        *("/state", "/state?waits=false", "/forecast", "/approvals", "/inventory", "/shares"),
        *("/events", "/events?last=50", f"/events?mentions={name}", f"/events?correlation={name}"),
        *(f"/events?stream={runs[0]}", "/events?stored=true", "/events?type=run"),
        *("/find?words=secret", f"/find?run={runs[0]}"),
    )
    posts = (f"/campaigns/{name}/clone", f"/campaigns/{name}/pause", f"/campaigns/{name}/cancel")
    posts += (f"/campaigns/{name}/amend", f"/campaigns/{name}/archive", f"/runs/{runs[0]}/cancel")
    posts += (f"/runs/{runs[0]}/pause",)
    with (
        client_of(people.lab, people.tokens["eve"]) as eve,
        client_of(people.lab, people.tokens["olga"]) as olga,
    ):
        found = set()
        for page in pages:
            answer = eve.get(page)
            sees_nothing(answer.text.replace(page, ""), name, runs) if answer.status_code == 200 else None
            assert answer.status_code in (200, 404), (page, answer.text)
            assert "bob's" not in answer.text
            found |= {page} if "secret" in olga.get(page).text else set()
        assert {"/campaigns", "/runs?ended=50", "/state", "/events", "/forecast"} <= found
        for page in posts:
            answer = eve.post(page, json={})
            assert answer.status_code == 404, (page, answer.text)
            assert answer.json()["code"] == "not_found"
        # Of another name that there is none of, the same is said.
        unknown, known = eve.get("/campaigns/C999"), eve.get(f"/campaigns/{name}")
        assert unknown.text.replace("C999", name) == known.text
    people["bob"].cancel_campaign(name, "")


@pytest.mark.slow
def test_an_api_process_keeps_the_same_back(people: People, folder: Path) -> None:
    name = people.screen("private", "secret behind")
    runs = people.runs_of(name)
    with ApiThread(ApiSettings(Settings.make(folder / "lab"), "one")) as api:
        for user in ("bob", "eve", "cleo", "olga"):
            sees = user in SEES["private"]
            with LabClient(api.url, token=people.tokens[user]) as client:
                until(
                    lambda c=client: c.health()["position"] >= people.lab.runtime.kernel.durable, "it follows"
                )
                assert (name in [c["id"] for c in client.campaigns()]) is sees, user
                assert (runs[0] in [run["id"] for run in client.runs()["runs"]]) is sees, user
                assert (runs[0] in [run["id"] for run in client.state()["runs"]]) is sees, user
                assert any(e["payload"].get("campaign") == name for e in client.events()) is sees, user
                if not sees:
                    with pytest.raises(NotFound):
                        client.campaign(name)
    people["bob"].cancel_campaign(name, "")


@pytest.mark.slow
def test_the_command_line_of_others_shows_nothing(people: People) -> None:
    name = people.screen("private", "secret rows")
    runs = people.runs_of(name)
    for words in (("campaign", "list", "--all"), ("runs", "--all"), ("log",), ("log", "--json")):
        mine = people.labos("bob", *words)
        assert (mine.exit_code, "secret" in mine.output) == (0, True), (words, mine.output)
        other = people.labos("eve", *words)
        assert (other.exit_code, "secret" in other.output) == (0, False), (words, other.output)
    for words in (("campaign", "show", name), ("campaign", "report", name), ("runs", runs[0])):
        assert people.labos("bob", *words).exit_code == 0, words
        assert isinstance(people.labos("eve", *words).exception, NotFound), words
    shown = json.loads(people.labos("bob", "campaign", "show", name, "--json").output)
    assert shown["visibility"] == "private"
    assert "its user" in people.labos("bob", "campaign", "show", name).output
    # A clone is private, too, unless it is said otherwise.
    again = people.labos("bob", "campaign", "clone", name).stdout.strip()
    people["bob"].cancel_campaign(name, "")
    open_one = people.labos("bob", "campaign", "clone", name, "--visibility", "lab").stdout.strip()
    seen = {c["id"] for c in people["eve"].campaigns()}
    assert again not in seen
    assert open_one in seen
    for each in (again, open_one):
        people["bob"].cancel_campaign(each, "")


@pytest.mark.slow
def test_a_stream_keeps_back_what_begins_while_it_is_followed(people: People) -> None:
    heard: dict[str, list[dict[str, Any]]] = {"eve": [], "cleo": [], "olga": []}
    after = people.lab.runtime.kernel.durable
    over = threading.Event()

    def follow(user: str) -> None:
        client = httpx.Client(
            base_url=people.url + "/api/v1",
            timeout=60,
            headers={"authorization": f"Bearer {people.tokens[user]}"},
        )
        with client, client.stream("GET", "/events/stream", params={"after": after}) as answer:
            for line in answer.iter_lines():
                if line.startswith("data: "):
                    heard[user].append(json.loads(line.removeprefix("data: ")))
                if over.is_set() and heard[user] and heard[user][-1]["type"] == "shares.applied":
                    return

    threads = [threading.Thread(target=follow, args=(user,), daemon=True) for user in heard]
    for thread in threads:
        thread.start()
    first = people.screen("lab", "for all")
    until(lambda: all(heard.values()), "all hear what everybody sees")
    private, of_group = people.screen("private", "secret one"), people.screen("group", "secret two")
    for name in (private, of_group, first):
        people.runs_of(name)
        people["bob"].cancel_campaign(name, "")
    over.set()
    people["ada"].apply_shares(SHARES.replace("physics", "biology"), "shares.yaml", "")
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    told = {user: {event["payload"].get("campaign") for event in events} for user, events in heard.items()}
    assert all(first in names for names in told.values())
    assert {private, of_group} <= told["olga"]
    assert of_group in told["cleo"]
    assert private not in told["cleo"]
    assert not {private, of_group} & told["eve"]
    assert "secret" not in json.dumps(heard["eve"])


def test_an_open_lab_hides_nothing(tmp_path: Path) -> None:
    from labos.bootstrap import descriptions
    from labos.settings import Settings
    from labos.spec import find_spec, load_workcell

    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as lab, LabClient(lab.url) as client:
        text = "labos: 1\ncampaign: c\nworkflow: s\nvisibility: private\nrows: {list: [{time: 1}]}\n"
        told = {"text": text, "name": "c.yaml", "workflow": {"text": SEAL, "name": "s"}}
        name = client.submit_campaign(told, user="bob")["campaign"]
        assert client.campaign(name)["visibility"] == "private"
        assert any(event["type"] == "campaign.submitted" for event in client.events())
