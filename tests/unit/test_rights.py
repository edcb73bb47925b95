"""Every way to ask for something is in the table of rights, and agrees with it."""

from __future__ import annotations

import ast
from pathlib import Path

import labos
from labos.core.decide.rights import RIGHTS
from labos.http.routes import OPERATIONS
from tests.docs.generate import commands
from tests.docs.operation_rights import ASKED_BY, BY_ITSELF, GIVES, find_least_role

BY_NOBODY = {"RecordStops"}
"""Commands that no operation gives as such: a stop is recorded by the lab."""


def test_each_operation_needs_what_its_commands_need() -> None:
    assert {op.id: op.needs for op in OPERATIONS} == {op.id: find_least_role(op.id) for op in OPERATIONS}


def test_no_operation_changes_something_without_a_right() -> None:
    """Those that are not in the tables only look; requests that look are GETs."""
    known = {*GIVES, *BY_ITSELF}
    assert {op.id for op in OPERATIONS if op.method == "POST"} == known
    assert set(ASKED_BY) <= known


def test_each_command_that_somebody_may_ask_for_has_an_operation() -> None:
    given = {command.__name__ for found in GIVES.values() for command in found}
    asked = {command.__name__ for command, right in RIGHTS.items() if right.role is not None}
    assert asked - given == BY_NOBODY
    assert given <= asked


def test_the_commands_of_labos_that_are_named_exist() -> None:
    names = {path for path, _, _ in commands()}
    assert {name for found in ASKED_BY.values() for name in found} <= names


def test_commands_that_http_gives_are_those_of_the_table() -> None:
    """Whatever the server carries out was asked for by an operation that says so."""
    given = {command.__name__ for found in GIVES.values() for command in found} | BY_NOBODY
    inside = {"LoseExperiment", "SubmitRow", "RefuseRow"}
    for path in sorted((Path(labos.__file__).parent / "http").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            called = node.func if isinstance(node, ast.Call) else None
            name = called.id if isinstance(called, ast.Name) else ""
            if name in {command.__name__ for command in RIGHTS}:
                assert name in given | inside, f"{path.name} gives {name}"
