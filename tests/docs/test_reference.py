"""The reference says what the code says: commands, events, messages, routes, settings."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import click
import msgspec
import pytest

from labos.core.decide.reactions import REACTIONS
from labos.core.envelope import Envelope
from labos.core.registry import TYPES
from labos.http.routes import OPERATIONS
from labos.node import protocol
from labos.node._admin import Admin
from labos.settings import DATABASE, HOME, KernelInfo, Settings
from tests.docs.generate import commands, renew, schemas
from tests.docs.markdown import (
    REFERENCE,
    ROOT,
    first_codes,
    headings,
    section,
    table,
)


def page(name: str) -> str:
    return (REFERENCE / name).read_text()


@pytest.mark.parametrize(
    "name",
    [
        "cli.md",
        "events.md",
        "http.md",
        "metrics.md",
        "sql.md",
        "reactions.md",
        "machines.md",
        "waits.md",
        "questions.md",
        "node-protocol.md",
        "badges.md",
        "../torture.md",
        "../descriptions.md",
    ],
)
def test_generated_parts_are_fresh(name: str) -> None:
    assert page(name) == renew(page(name)), "run `python -m tests.docs.generate`"


def test_published_schemas_are_fresh_and_no_others() -> None:
    published = {path: path.read_text() for path in (REFERENCE / "schemas").iterdir()}
    assert published == schemas(), "run `python -m tests.docs.generate`"


# -- commands ----------------------------------------------------------------------------------


def test_every_command_and_option_is_told_and_no_other() -> None:
    text = page("cli.md")
    told: dict[str, set[str]] = {}
    for heading in headings(text):
        if heading.startswith("labos"):
            cells = " ".join(row[0] for row in table(section(text, heading)) if row[0].startswith("`-"))
            told[heading] = set(re.findall(r"`(--?[\w-]+)`", cells))
    real = {
        path: {
            name
            for option in command.params
            if isinstance(option, click.Option)
            for name in (*option.opts, *option.secondary_opts)
        }
        for path, command, _ in commands()
    }
    assert told == real


def test_every_command_and_option_says_what_it_means() -> None:
    silent = [
        f"{path} {option.opts[0]}"
        for path, command, _ in commands()
        for option in command.params
        if isinstance(option, click.Option) and not (option.help or "").strip()
    ]
    silent += [path for path, command, _ in commands() if not (command.help or "").strip()]
    assert silent == []


# -- events ------------------------------------------------------------------------------------


def test_every_event_and_field_is_told_and_no_other() -> None:
    text = page("events.md")
    told = {
        heading.split()[0]: first_codes(section(text, heading))
        for heading in headings(text)
        if re.fullmatch(r"\w+\.\w+( \(schema \d+\))?", heading)
    }
    assert told == {name: list(kind.__struct_fields__) for name, kind in TYPES.items()}


def test_every_event_says_what_it_means() -> None:
    text = page("events.md")
    for name, kind in TYPES.items():
        first = inspect.cleandoc(kind.__doc__ or "").replace("``", "`").split(". ")[0]
        heading = name if kind.SCHEMA == 1 else f"{name} (schema {kind.SCHEMA})"
        assert first in section(text, heading), name


def test_every_reaction_is_told_and_says_in_one_sentence_what_follows() -> None:
    rows = table(page("reactions.md"))
    for kind, found in REACTIONS.items():
        assert [f"`{kind.TYPE}`", ", ".join(f"`{react.__name__}`" for react in found)] in rows
    for react in {react for found in REACTIONS.values() for react in found}:
        words = " ".join((react.__doc__ or "").split())
        assert re.fullmatch(r"[A-Z][^.]+\.", words)
        assert [f"`{react.__name__}`", words] in rows


def test_the_envelope_is_told() -> None:
    assert first_codes(section(page("events.md"), "The envelope")) == list(Envelope.__struct_fields__)


# -- node protocol -----------------------------------------------------------------------------


def test_every_message_and_field_is_told_and_no_other() -> None:
    text = section(page("node-protocol.md"), "Messages")
    told = {heading: first_codes(section(text, heading)) for heading in headings(text)}
    real = {
        kind.__name__: list(kind.__struct_fields__)
        for kind in vars(protocol).values()
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and kind is not protocol.Message
    }
    assert told == real


def test_the_six_operations_are_told() -> None:
    named = re.search(r"\{(.*?)\}``? answer", protocol.__doc__ or "")
    assert named
    told = first_codes(section(page("node-protocol.md"), "Operations"))
    assert sorted(told) == sorted(named[1].split(","))
    assert len(told) == 6


def test_the_commands_of_admin_are_told() -> None:
    told = first_codes(section(page("node-protocol.md"), "Commands of admin"))
    assert sorted(told) == sorted(Admin.list_commands(Admin.__new__(Admin)))


# -- settings ----------------------------------------------------------------------------------


def test_every_environment_variable_is_told_and_no_other() -> None:
    named = {
        name
        for path in (ROOT / "labos").rglob("*.py")
        for name in re.findall(r'"(LABOS_[A-Z_]+)"', path.read_text())
    }
    told = first_codes(section(page("settings.md"), "Environment"))
    assert sorted(told) == sorted(named)
    assert {HOME, DATABASE} <= named


def test_every_file_of_the_home_is_told() -> None:
    settings = Settings.make("/somewhere", "sqlite:////elsewhere/lab.db")
    folders = {
        value.name
        for name, kind in vars(Settings).items()
        if isinstance(kind, property)
        for value in (getattr(settings, name),)
        if isinstance(value, Path)
    }
    files = set(re.findall(r'home / "([\w.]+\.\w+)"', (ROOT / "labos/settings.py").read_text()))
    told = {name.rstrip("/") for name in first_codes(section(page("settings.md"), "The lab's folder"))}
    assert folders | files <= told
    assert settings.home == Path("/somewhere")


def test_kernel_json_is_told() -> None:
    assert first_codes(section(page("settings.md"), "kernel.json")) == list(KernelInfo.__struct_fields__)


# -- HTTP --------------------------------------------------------------------------------------


def test_the_page_has_a_section_for_every_operation() -> None:
    told = [heading for heading in headings(page("http.md")) if re.match(r"(GET|POST|PUT|DELETE) ", heading)]
    assert told == [f"{operation.method} {operation.path}" for operation in OPERATIONS]


def test_every_field_and_parameter_says_what_it_means() -> None:
    for operation in OPERATIONS:
        heading = f"{operation.method} {operation.path}"
        for row in table(section(page("http.md"), heading)):
            assert row[2], (heading, row[0])
