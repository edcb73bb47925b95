"""Every command with a lab on another computer: it works by the lab's address, or says that it needs the
lab's folder."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli._exit import DONE, FAILED
from labos.cli._remote import expect_folder, expect_folder_or_database
from labos.cli.app import main
from labos.client import LabClient, LabLog
from labos.ports import LogQuery
from labos.services.shown import ShownLog
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.store import open_store
from tests.docs.generate import commands

READ = {
    "runs": "labos runs",
    "runs R1": "labos runs",
    "explain R1": "labos explain",
    "forecast": "labos forecast",
    "experiments": "labos experiments",
    "results R1": "labos results",
    "files": "labos files",
    "stations": "labos stations",
    "stations --at 50": "labos stations",
    "labware": "labos labware",
    "labware P1": "labos labware",
    "samples show P1": "labos samples show",
    "interventions": "labos interventions",
    "inbox": "labos inbox",
    "locations pf400": "labos locations",
    "find": "labos find",
    "find pcr --kind run --facets": "labos find",
    "log": "labos log",
    "log --last 5": "labos log",
    "log --run R1 --since -1h": "labos log",
    "log --labware P1": "labos log",
    "campaign list": "labos campaign list",
    "campaign show C1": "labos campaign show",
    "campaign report C1": "labos campaign report",
    "shares": "labos shares",
    "approvals": "labos approvals",
    "policy": "labos policy",
    "erase": "labos erase",
    "whoami": "labos whoami",
    "token list": "labos token list",
    "user list": "labos user list",
    "group list": "labos group list",
    "bookings": "labos bookings",
    "calendar": "labos calendar",
    "role list": "labos role list",
    "sign R1": "labos sign",
}
"""Questions whose answers in JSON are the same by the address as from the folder."""

ACT = {
    "nodes": "labos nodes",
    "inventory": "labos inventory",
    "actions pf400": "labos actions",
    "twh": "labos twh",
    "plan pcr --workcell rpl": "labos plan",
    "handover-report": "labos handover-report",
    "submit pcr": "labos submit",
    "pause R1": "labos pause",
    "resume R1": "labos resume",
    "cancel R1": "labos cancel",
    "do sealer seal --no-wait": "labos do",
    "reset sealer --no-wait": "labos reset",
    "home sciclops --no-wait": "labos home",
    "out-of-service sealer --why x": "labos out-of-service",
    "in-service sealer": "labos in-service",
    "place wc.output plate96": "labos place",
    "barcode P1 X": "labos barcode",
    "give P1 --to shared": "labos give",
    "unload sciclops.tower1 --count 2": "labos unload",
    "load sciclops.tower1 --type plate96": "labos load",
    "observe hidex.default empty": "labos observe",
    "calibrate hidex --what volume --until 2031-01-01": "labos calibrate",
    "replenish sealer foil --lot L1 --amount 1 --instead": "labos replenish",
    "samples load sheet.csv": "labos samples load",
    "bench declare --empty": "labos bench declare",
    "resolve": "labos resolve",
    "workcell apply rpl --dry-run": "labos workcell apply",
    "access rpl": "labos access",
    "campaign plan screen.yaml": "labos campaign plan",
    "campaign submit screen.yaml": "labos campaign submit",
    "campaign pause C1": "labos campaign pause",
    "campaign resume C1": "labos campaign resume",
    "campaign amend C1 --priority 5": "labos campaign amend",
    "campaign cancel C1": "labos campaign cancel",
    "campaign clone C1 --dry-run": "labos campaign clone",
    "campaign archive C1": "labos campaign archive",
    "shares --apply shares.yaml": "labos shares",
    "logout": "labos logout",
    "book hidex --from now --to +1h --maintenance": "labos book add",
    "book show B1": "labos book show",
    "book change B1 --to +2h": "labos book change",
    "book cancel B1": "labos book cancel",
    "group add chemistry": "labos group add",
    "group remove chemistry": "labos group remove",
}
"""What is done in the lab."""

REFUSED_BY_THE_LAB = {
    "nodes --check pf400": ("labos nodes", "no node answers"),
    "node trace pf400": ("labos node trace", "No node answers"),
    "teach pf400 sealer.default --pose 1": ("labos teach", "joints|numbers|pose"),
    "confirm I99": ("labos confirm", "I99"),
    "approve R99": ("labos approve", "does not wait for an approval"),
    "refuse R99": ("labos refuse", "does not wait for an approval"),
    "erase 1 --because personal": ("labos erase", "There are no erasable words at these positions"),
    "bench round": ("labos bench round", "has not lost its end"),
    "estop sealer": ("labos estop", "NOT known to be stopped"),
    "run nothing-like-it": ("labos run", "nothing-like-it"),
    "login": ("labos login", "no users"),
    "token create x": ("labos token create", "no users"),
    "token revoke x": ("labos token revoke", "no token 'x'"),
    "user password eve": ("labos user password", "Only eve"),
    "user name eve": ("labos user name", "Only eve"),
    "user erase eve": ("labos user erase", "Only eve"),
    "user link eve https://login.example.org 1": ("labos user link", "Only admins"),
    "user add a/b": ("labos user add", "a/b"),
    "user show eve": ("labos user show", "no user 'eve'"),
    "user disable eve": ("labos user disable", "no active user 'eve'"),
    "user enable eve": ("labos user enable", "no active user 'eve'"),
    "group member add physics eve": ("labos group member add", "no group 'physics'"),
    "group member remove physics eve": ("labos group member remove", "no group 'physics'"),
    "role grant eve viewer": ("labos role grant", "no active user 'eve'"),
    "role revoke group:physics": ("labos role revoke", "no group 'physics'"),
    "validate pcr --workcell rpl --online": ("labos validate", "no node answers|silent"),
}
"""What this lab cannot do, says itself."""

CAMPAIGN = "labos: 1\ncampaign: c\nworkflow: pcr\nrows: {list: [{seal.time: 2}, {seal.time: 3}]}\n"

FOLDER = {
    path
    for path, command, _ in commands()
    if {option.callback for option in command.params} & {expect_folder, expect_folder_or_database}
}
"""The commands that need the folder of a lab."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    screen = tmp_path_factory.mktemp("campaign") / "screen.yaml"
    screen.write_text(CAMPAIGN)
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        with LabClient(running.url) as client:
            client.submit("pcr", user="ada")
            client.place("hidex.default", "plate96", "ada")
            client.submit_campaign(screen, user="ada")
        yield running


@pytest.fixture(autouse=True)
def elsewhere(lab: LabThread, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Another computer: an empty folder, and the address of the lab."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LABOS_HOME", raising=False)
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    monkeypatch.setenv("LABOS_URL", lab.url)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr("sys.stdin", io.StringIO())
    (tmp_path / "screen.yaml").write_text(CAMPAIGN)
    (tmp_path / "shares.yaml").write_text("labos: 1\nusers: {ada: {weight: 2}}\n")
    (tmp_path / "sheet.csv").write_text("plate,well,sample\nP1,A1,serum\n")
    yield tmp_path
    assert not (tmp_path / "lab").exists()


def say(*words: str) -> int:
    """The exit code of a command."""
    try:
        return main([*words])
    except SystemExit as over:
        return int(over.code or 0)


def test_no_command_is_left_out() -> None:
    with_a_lab = {
        path
        for path, command, context in commands()
        if any(isinstance(p, click.Option) and "--home" in p.opts for p in command.params)
        and (not isinstance(command, click.Group) or command.invoke_without_command)
    }
    tried = {*READ.values(), *ACT.values(), *(path for path, _ in REFUSED_BY_THE_LAB.values())}
    tried.add("labos export events")  # it answers in JSON without being told to
    # An agent speaks to `labos mcp`: see tests/integration/http/test_mcp.py.
    # A planner looks on until it is ended: see test_planner.py.
    without_end = {"labos demo", "labos bus", "labos mcp", "labos api", "labos planner"}
    assert tried | FOLDER | without_end == with_a_lab
    assert not tried & FOLDER


@pytest.mark.slow
def test_what_is_done_is_done_there(lab: LabThread, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ACT:
        code = say(*words.split())
        said = capsys.readouterr()
        assert code == DONE, (words, said)
    with LabClient(lab.url) as client:
        actors = {event["actor"] for event in client.events(type="labware")}
        assert client.state()["lab"]["access"]
        client.leave("rpl", "ada")
    assert actors


@pytest.mark.slow
@pytest.mark.parametrize("words", REFUSED_BY_THE_LAB)
def test_what_cannot_be_done_is_said_by_the_lab(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    _, expected = REFUSED_BY_THE_LAB[words]
    assert say(*words.split()) == FAILED
    said = capsys.readouterr()
    assert any(word in said.err + said.out for word in expected.split("|")), said


@pytest.mark.parametrize("words", READ)
def test_what_is_asked_is_answered_as_from_the_folder(
    lab: LabThread, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["samples", "load", "sheet.csv", "--replace"])
    capsys.readouterr()
    assert main([*words.split(), "--json"]) == DONE, capsys.readouterr()
    there = capsys.readouterr()
    assert main([*words.split(), "--json", "--home", str(lab.settings.home)]) == DONE
    here = capsys.readouterr()
    assert (there.out, there.err) == (here.out, here.err)
    assert there.out.strip()


def test_events_are_exported_as_from_the_folder(lab: LabThread, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["export", "events", "--since", "3", "--family", "labware", "--family", "run.submitted"]
    assert main(words) == DONE
    there = capsys.readouterr().out
    assert main([*words, "--home", str(lab.settings.home)]) == DONE
    assert there == capsys.readouterr().out
    assert '"type":"labos.run.submitted"' in there


@pytest.mark.parametrize("path", sorted(FOLDER))
def test_what_needs_the_folder_says_so(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = {
        "labos audit reader": ["grafana"],
        "labos bundle": ["R1", "-o", "R1.zip"],
        "labos diff": ["--since", "1"],
        "labos export crate": ["R1", "--to", "R1.zip"],
        "labos provenance": ["P1"],
        "labos witness": ["--public-key", "other.pub"],
        "labos backup": ["to"],
        "labos restore": ["from"],
        "labos db writer": ["kernel"],
        "labos node accept-unit": ["rpl/pf400"],
        "labos node install": ["rpl/pf400", "--connect", "tcp/lab:7447"],
        "labos node reset-epoch": ["rpl/pf400", "--epoch", "1", "--why", "x"],
        "labos node start": ["pf400", "--name", "pf400", "--workcell", "rpl"],
        "labos notifications test": ["ada"],
        "labos pki admit": ["node", "rpl/pf400", "--certificate", "a.pem", "--key", "a.key"],
        "labos pki issue": ["bus"],
        "labos pki renew": ["rpl/pf400"],
        "labos pki revoke": ["rpl/pf400", "--why", "x"],
        "labos up": ["rpl"],
    }.get(path, [])
    if path == "labos restore":
        Path("from").mkdir()
    code = main([*path.split()[1:], *words])
    said = capsys.readouterr()
    assert code == FAILED, said
    assert re.search("`labos .*` needs the folder of the lab, and LABOS_URL names a lab", said.err), said


def test_a_database_is_enough_for_what_reads_it(lab: LabThread, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["sql", "SELECT count(*) FROM runs"], ["verify", "--json"]):
        assert main([*words, "--database", lab.settings.database]) in (DONE, FAILED)
        assert "needs the folder" not in capsys.readouterr().err


def test_what_is_no_address_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("LABOS_URL", "lab7:8080")
    assert main(["runs"]) == FAILED
    assert "LABOS_URL is 'lab7:8080', which is no address" in capsys.readouterr().err


def test_the_log_is_the_same_by_the_address(lab: LabThread) -> None:
    store = open_store(lab.settings.database, create=False, read_only=True)
    try:
        with LabClient(lab.url) as client:
            far, shown_far, shown = LabLog(client, stored=True), LabLog(client), ShownLog(store)
            assert far.head().position == store.head().position
            begun = next(store.read(3, 4)).head.recorded_at
            for query in (
                LogQuery(),
                LogQuery(after=7, upto=40),
                LogQuery(types=("labware", "run.submitted")),
                LogQuery(streams=("R1",)),
                LogQuery(mentions="P1", last=2),
                LogQuery(last=5000),
                LogQuery(since_ns=begun, upto=60),
                LogQuery(until_ns=begun + 1, last=1),
                LogQuery(upto=0),
            ):
                assert list(far.select(query)) == list(store.select(query)), query
                told = [record.payload for record in shown_far.select(query)]
                assert told == [record.payload for record in shown.select(query)], query
            assert list(far.replay(5, 30)) == list(store.replay(5, 30))
    finally:
        store.close()
