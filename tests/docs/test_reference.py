"""The reference says what the code says: commands, events, messages, routes, settings."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
import typing
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import msgspec
import pytest
from starlette.routing import Route

import labos.errors
import labos.http.app
from labos.core.envelope import Envelope
from labos.core.registry import TYPES
from labos.http.app import create_app
from labos.http.errors import code_of, status_of
from labos.http.views import lab_view
from labos.node import protocol
from labos.node._admin import Admin
from labos.settings import DATABASE, HOME, KernelInfo, Settings
from labos.spec import SpecErrors
from tests.docs.generate import commands, renewed, schemas
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
    "name", ["cli.md", "events.md", "node-protocol.md", "badges.md", "../torture.md", "../descriptions.md"]
)
def test_generated_parts_are_fresh(name: str) -> None:
    assert page(name) == renewed(page(name)), "run `python -m tests.docs.generate`"


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
    assert sorted(told) == sorted(Admin.commands(Admin.__new__(Admin)))


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
    settings = Settings.of("/somewhere", "sqlite:////elsewhere/lab.db")
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


def routes() -> dict[str, Callable[..., Any]]:
    """Handlers by ``METHOD /path``, without converters."""
    app = create_app(SimpleNamespace(kernel=None, feed=None))  # type: ignore[arg-type]
    return {
        f"{method} {re.sub(r':[a-z]+}', '}', route.path)}": inspect.unwrap(route.endpoint)
        for route in app.routes
        if isinstance(route, Route)
        for method in (route.methods or set()) - {"HEAD"}
    }


def test_every_route_is_told_and_no_other() -> None:
    told = [heading for heading in headings(page("http.md")) if re.match(r"(GET|POST|PUT|DELETE) ", heading)]
    assert sorted(told) == sorted(routes())


@pytest.mark.parametrize("route", sorted(route for route in routes() if route.startswith("POST")))
def test_every_field_of_a_request_is_told(route: str) -> None:
    names = (getattr(labos.http.app, name, None) for name in _code(routes()[route]).co_names)
    body = next((kind for kind in names if isinstance(kind, type) and issubclass(kind, msgspec.Struct)), None)
    rows = table(section(page("http.md"), route))
    told = {row[0].strip("`"): row[1].startswith("required") for row in rows}
    fields = msgspec.structs.fields(body) if body is not None else ()
    assert told == {field.encode_name: field.required for field in fields}


@pytest.mark.parametrize("route", sorted(route for route in routes() if route.startswith("GET")))
def test_every_query_parameter_is_told(route: str) -> None:
    source = inspect.getsource(routes()[route])
    asked = re.findall(r'(?:params\.get(?:list)?|wire\.number|wire\.seconds)\((?:request, )?"(\w+)"', source)
    text = section(page("http.md"), route)
    assert [name for name in asked if f"`{name}`" not in text and f"`{name}=" not in text] == []
    if first_codes(text) and "| query |" in text:
        assert sorted(first_codes(text)) == sorted(asked)


def test_the_answers_keys_are_told() -> None:
    assert first_codes(section(page("http.md"), "GET /state")) == _keys(lab_view)
    health = section(page("http.md"), "GET /health")
    assert [key for key in _keys(routes()["GET /health"]) if f"`{key}`" not in health] == []


def test_every_error_has_the_status_that_is_told() -> None:
    kinds = {
        code_of(kind): kind
        for kind in (*vars(labos.errors).values(), SpecErrors)
        if isinstance(kind, type) and issubclass(kind, labos.errors.LabosError)
    }
    for codes, status in table(section(page("http.md"), "Errors")):
        for code in re.findall(r"`(\w+)`", codes):
            if code != "internal":
                assert status_of(kinds[code].__new__(kinds[code])) == int(status), code


def _code(handler: Callable[..., Any]) -> Any:
    return typing.cast(Any, handler).__func__.__code__


def _keys(function: Callable[..., Any]) -> list[str]:
    """The keys of the largest table that a function writes down, in order."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    tables = [node for node in ast.walk(tree) if isinstance(node, ast.Dict)]
    outer = max(tables, key=lambda node: (node.end_lineno or 0) - node.lineno)
    return [key.value for key in outer.keys if isinstance(key, ast.Constant)]
