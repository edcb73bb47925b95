"""One option for one meaning, over all commands."""

from __future__ import annotations

import click
import pytest

from labos.cli.app import group
from tests.docs.generate import commands

ONE_NAME = {
    "--why": ("--note", "--reason", "--comment", "--message", "--remark", "--say-why"),
    "--wait": ("--block", "--follow-run", "--detach", "--background", "--async"),
    "--output": ("--out", "--to-file", "--into", "--target", "--dest", "--destination"),
    "--json": ("--format", "--as-json", "--machine"),
    "--user": ("--by", "--as", "--who", "--actor"),
    "--home": ("--lab", "--folder", "--dir"),
    "--database": ("--db", "--url", "--dsn"),
    "--yes": ("--assume-yes", "--no-ask", "--confirm"),
    "--force": ("--overwrite",),
    "--quiet": ("--silent",),
    "--dry-run": ("--check-only", "--what-if"),
    "--simulate": ("--simulation", "--simulated", "--sim"),
    "--for": ("--of", "--whose"),
    "--type": ("--kind", "--labware-type"),
    "--since": ("--after", "--begin", "--start"),
    "--until": ("--before", "--end", "--stop"),
    "--last": ("--limit", "--max", "--tail", "-n"),
    "--all": ("--everything", "--full"),
}
"""The name of a meaning, and names that nothing else may bear it by."""

OTHER_MEANINGS = {("labos find", "--kind")}
"""What is found is a run or a sample, which is no type of labware or of events."""


def options() -> list[tuple[str, click.Option]]:
    return [
        (path, p) for path, command, _ in commands() for p in command.params if isinstance(p, click.Option)
    ]


def names(option: click.Option) -> list[str]:
    return [*option.opts, *option.secondary_opts]


def test_no_meaning_has_two_names() -> None:
    forbidden = {other: name for name, others in ONE_NAME.items() for other in others}
    wrong = [
        f"{path} {said}: say {forbidden[said]}"
        for path, option in options()
        for said in names(option)
        if said in forbidden and (path, said) not in OTHER_MEANINGS
    ]
    assert wrong == []


def test_no_name_has_two_forms() -> None:
    for path, option in options():
        said = names(option)
        if "--why" in said:
            assert (option.is_flag, option.metavar) == (False, "TEXT"), path
        if "--wait" in said or "--no-wait" in said:
            assert {"--wait", "--no-wait"} <= set(said), f"{path}: wait_option has both"
        if "--output" in said or "-o" in said:
            assert {"--output", "-o"} <= set(said), path
        if "--json" in said:
            assert (option.is_flag, option.name) == (True, "as_json"), path
        if {"--all", "--force", "--yes", "--quiet", "--simulate"} & set(said):
            assert option.is_flag, path


TWO_FORMS = {
    "--bundle": "a bundle that is checked; that each run's is put into a crate",
    "--check": "a check of the torture; that nodes are checked",
    "--keep": "a folder for what was tortured; that the demonstration's lab runs on",
    "--simulate": "a device, or the bench of a lab, which may be real as well",
    "--secure": "a bus, or that of a lab, which may do without",
    "--trace": "the wire of one node, into this file; those of all nodes, each into its own",
    "--witness": "who cosigns a checkpoint; the key with which others' are cosigned",
}
"""Names that say something by themselves in one command, and something of a value in another: what they mean
there is not the same."""


def test_a_name_takes_a_value_everywhere_or_nowhere() -> None:
    forms: dict[str, set[tuple[bool, bool]]] = {}
    for _, option in options():
        for said in option.opts:
            if said.startswith("--"):
                forms.setdefault(said, set()).add((option.is_flag, bool(option.secondary_opts)))
    assert {said for said, found in forms.items() if len(found) > 1} == TWO_FORMS.keys()


def test_a_short_name_goes_with_its_long_one_everywhere() -> None:
    short = {
        long: said
        for _, option in options()
        for long in option.opts
        for said in option.opts
        if long.startswith("--") and not said.startswith("--")
    }
    assert short == {"--follow": "-f", "--output": "-o", "--payload": "-p"}
    lacking = [
        f"{path} {name}"
        for path, option in options()
        for name in short
        if name in option.opts and short[name] not in option.opts
    ]
    assert lacking == []


@pytest.mark.parametrize(
    ("command", "waits"), [("submit", False), ("cancel", False), ("do", True), ("reset", True)]
)
def test_whether_to_wait_is_asked_alike_everywhere(command: str, waits: bool) -> None:
    found = group.get_command(click.Context(group), command)
    assert found is not None
    words = {"do": ["sealer", "seal"]}.get(command, ["x"])
    for said, wanted in ((["--wait"], True), (["--no-wait"], False), ([], waits)):
        assert found.make_context(command, [*words, *said]).params["wait"] is wanted
