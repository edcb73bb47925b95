"""The group of all commands: its help, and a name that no command has."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from labos.cli.app import COMMANDS, GROUPS, group


def test_the_help_shows_every_command_once_under_its_heading() -> None:
    told = CliRunner().invoke(group, ["--help"]).output
    for heading in GROUPS:
        assert f"{heading}:\n" in told
    rows = [line.split()[0] for line in told.splitlines() if line.startswith("  ") and line[2:3].islower()]
    assert [name for name in rows if name in COMMANDS] == list(COMMANDS)
    assert all(len(line) <= 80 for line in told.splitlines())


@pytest.mark.parametrize(("typed", "meant"), [("cancle", "cancel"), ("experiment", "experiments")])
def test_a_mistyped_command_is_answered_with_the_right_one(typed: str, meant: str) -> None:
    asked = CliRunner().invoke(group, [typed])
    assert asked.exit_code == 2
    assert f"There is no command {typed!r}. Did you mean {meant}" in asked.output


def test_a_command_like_no_other_is_answered_with_where_all_are() -> None:
    asked = CliRunner().invoke(group, ["xyzzy"])
    assert asked.exit_code == 2
    assert "`labos --help` shows all commands." in asked.output
