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
    with LabThread(Settings.of(tmp_path / "lab", simulate=True), nodes="none"):
        yield tmp_path / "lab"


def said(home: Path, *words: str, user: str = "ada", fails: bool = False) -> str:
    """What a command says; ``user`` asks."""
    env = {"LABOS_USER": user}
    with LabClient(home=home) as owner:
        if user in [known["id"] for known in owner.users() if not known["disabled"]]:
            env["LABOS_TOKEN"] = owner.make_token(scope="admin", user=user)["secret"]
    result = CliRunner().invoke(group, [*words, "--home", str(home)], env=env)
    assert (result.exit_code != 0) == fails, result.output
    return result.output if not fails else f"{result.output}{result.exception}"


def told(home: Path, *words: str, user: str = "ada") -> Any:
    return json.loads(said(home, *words, "--json", user=user))


def test_people_are_added_grouped_and_given_roles(home: Path) -> None:
    assert "may do everything" in said(home, "user", "list")
    assert "ada is the admin of this lab" in said(home, "user", "add", "ada", user="whoever")
    bo = told(home, "user", "add", "bo", "--role", "submitter")
    assert (bo["id"], bo["kind"], bo["roles"]) == ("bo", "person", {"*": "submitter"})
    assert told(home, "user", "add", "robot", "--service")["kind"] == "service"
    said(home, "group", "add", "chemistry")
    assert told(home, "group", "member", "add", "chemistry", "bo")["members"] == ["bo"]
    said(home, "role", "grant", "group:chemistry", "operator")
    assert "roles of the group: operator" in said(home, "user", "show", "bo")
    grants = told(home, "role", "list")
    assert {"subject": "group:chemistry", "scope": "*", "role": "operator"} in grants
    assert "operator   group:chemistry  the whole lab" in said(home, "role", "list")
    assert told(home, "user", "disable", "robot")["disabled"]
    assert not told(home, "user", "enable", "robot")["disabled"]
    said(home, "role", "revoke", "group:chemistry")
    assert told(home, "group", "member", "remove", "chemistry", "bo")["members"] == []
    said(home, "group", "remove", "chemistry")
    assert told(home, "group", "list") == []


def test_whoever_is_added_is_told_with_what_to_do_next(home: Path) -> None:
    assert said(home, "user", "add", "ada").endswith("Next: labos user password ada\n")
    bo = said(home, "user", "add", "bo")
    assert bo == "bo is a user of this lab: may look.\nNext: labos user password bo\n"
    planner = said(home, "user", "add", "planner", "--service", "--role", "operator")
    assert planner.splitlines() == [
        "planner is a service account of this lab: operator.",
        "Next: labos token create LABEL --for planner",
    ]
    assert "planner" in said(home, "token", "create", "agent", "--for", "planner")
    assert [token["label"] for token in told(home, "token", "list", "--for", "planner")] == ["agent"]


def test_who_may_not_is_told_who_may(home: Path) -> None:
    said(home, "user", "add", "ada")
    said(home, "user", "add", "bo")
    refusal = said(home, "user", "add", "eve", user="bo", fails=True)
    assert "needs the role admin of the whole lab" in refusal
    assert "ada" in refusal
    assert "labos login" in said(home, "role", "grant", "bo", "admin", user="eve", fails=True)
    assert "only admin" in said(home, "user", "disable", "ada", fails=True)
    assert "no workcell 'mars'" in said(
        home, "role", "grant", "bo", "operator", "--workcell", "mars", fails=True
    )
