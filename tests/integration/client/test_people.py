"""``labos user``, ``labos group`` and ``labos role`` against a lab that runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.bootstrap import LabThread
from labos.cli.app import group
from labos.client import LabClient
from labos.settings import Settings


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Path]:
    with LabThread(Settings.make(tmp_path / "lab", simulate=True), nodes="none"):
        yield tmp_path / "lab"


def run_command(home: Path, *words: str, user: str = "ada", fails: bool = False) -> str:
    """What a command says; ``user`` asks."""
    env = {"LABOS_USER": user}
    with LabClient(home=home) as owner:
        if user in [known["id"] for known in owner.users() if not known["disabled"]]:
            env["LABOS_TOKEN"] = owner.make_token(scope="admin", user=user)["secret"]
    result = CliRunner().invoke(group, [*words, "--home", str(home)], env=env)
    assert (result.exit_code != 0) == fails, result.output
    return result.output if not fails else f"{result.output}{result.exception}"


def run_for_json(home: Path, *words: str, user: str = "ada") -> Any:
    return json.loads(run_command(home, *words, "--json", user=user))


def test_people_are_added_grouped_and_given_roles(home: Path) -> None:
    assert "has all rights" in run_command(home, "user", "list")
    assert "ada is the admin of this lab" in run_command(home, "user", "add", "ada", user="whoever")
    bo = run_for_json(home, "user", "add", "bo", "--role", "submitter")
    assert (bo["id"], bo["kind"], bo["roles"]) == ("bo", "person", {"*": "submitter"})
    assert run_for_json(home, "user", "add", "robot", "--service")["kind"] == "service"
    run_command(home, "group", "add", "chemistry")
    assert run_for_json(home, "group", "member", "add", "chemistry", "bo")["members"] == ["bo"]
    run_command(home, "role", "grant", "group:chemistry", "operator")
    assert "roles of the group: operator" in run_command(home, "user", "show", "bo")
    grants = run_for_json(home, "role", "list")
    assert {"subject": "group:chemistry", "scope": "*", "role": "operator"} in grants
    assert "operator   group:chemistry  the whole lab" in run_command(home, "role", "list")
    assert run_for_json(home, "user", "disable", "robot")["disabled"]
    assert not run_for_json(home, "user", "enable", "robot")["disabled"]
    run_command(home, "role", "revoke", "group:chemistry")
    assert run_for_json(home, "group", "member", "remove", "chemistry", "bo")["members"] == []
    run_command(home, "group", "remove", "chemistry")
    assert run_for_json(home, "group", "list") == []


def test_whoever_is_added_is_told_with_what_to_do_next(home: Path) -> None:
    assert run_command(home, "user", "add", "ada").endswith("Next: labos user password ada\n")
    bo = run_command(home, "user", "add", "bo")
    assert bo == "bo is a user of this lab: may read.\nNext: labos user password bo\n"
    planner = run_command(home, "user", "add", "planner", "--service", "--role", "operator")
    assert planner.splitlines() == [
        "planner is a service account of this lab: operator.",
        "Next: labos token create LABEL --for planner",
    ]
    assert "planner" in run_command(home, "token", "create", "agent", "--for", "planner")
    assert [token["label"] for token in run_for_json(home, "token", "list", "--for", "planner")] == ["agent"]


def test_who_may_not_is_told_who_may(home: Path) -> None:
    run_command(home, "user", "add", "ada")
    run_command(home, "user", "add", "bo")
    refusal = run_command(home, "user", "add", "eve", user="bo", fails=True)
    assert "needs the role admin of the whole lab" in refusal
    assert "ada" in refusal
    assert "labos login" in run_command(home, "role", "grant", "bo", "admin", user="eve", fails=True)
    assert "only admin" in run_command(home, "user", "disable", "ada", fails=True)
    assert "no workcell 'mars'" in run_command(
        home, "role", "grant", "bo", "operator", "--workcell", "mars", fails=True
    )
