"""The client speaks to the operations that the API declares, and to each of them."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

import labos.client
from labos.client import AsyncExperiment, AsyncLabClient, Experiment, LabClient, _batches, _runs
from labos.core.decide.composites import MOST_RUNS
from labos.core.runs import RUN_ENDS
from labos.http.limits import MOST_FILES
from labos.http.routes import OPERATIONS
from tests.docs import client_code

ASKING = {"_get": "GET", "_fetch": "GET", "_post": "POST", "_request": "", "_ask": ""}
"""The client's own methods that send something; of the last two the first argument is the method."""

NOT_ASKED = {"follow_events"}
"""For browsers; the client asks for pages of events and waits for the next."""


def find_called() -> set[tuple[str, str]]:
    """Method and path of all that the client asks for; what is filled in is a star."""
    found = set()
    for file in Path(labos.client.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            function = node.func if isinstance(node, ast.Call) else None
            if isinstance(function, ast.Attribute) and isinstance(node, ast.Call) and function.attr in ASKING:
                given = [_text(argument) for argument in node.args]
                method = ASKING[function.attr] or (given.pop(0) if given else "")
                if given and given[0].startswith("/"):
                    found.add((method, given[0]))
    return found


def _text(node: ast.expr) -> str:
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_text(part) if isinstance(part, ast.Constant) else "*" for part in parts)
    return ""


def is_meant(path: str, operation: str) -> bool:
    declared = re.sub(r"\{\w+\}", "*", operation)
    return all(a == b or "*" in (a, b) for a, b in zip(path.split("/"), declared.split("/"), strict=True))


def matches(method: str, path: str) -> list[str]:
    same = [op for op in OPERATIONS if op.method == method and op.path.count("/") == path.count("/")]
    exact = [op.id for op in same if re.sub(r"\{\w+\}", "*", op.path) == path]
    return exact or [op.id for op in same if is_meant(path, op.path)]


def test_the_client_asks_for_nothing_that_is_not_declared() -> None:
    assert [call for call in find_called() if not matches(*call)] == []


def test_each_operation_can_be_asked_for_by_the_client() -> None:
    asked = {name for call in find_called() for name in matches(*call)}
    assert {op.id for op in OPERATIONS} - asked == NOT_ASKED


def test_the_methods_are_as_the_operations_say() -> None:
    """If not: ``python -m tests.docs.client_code``."""
    stale = [path.name for path, text in client_code.files().items() if path.read_text() != text]
    assert stale == []


def test_nothing_else_stands_beside_the_methods() -> None:
    assert set(client_code.FOLDER.glob("*.py")) == set(client_code.files())


def test_each_operation_has_a_method() -> None:
    assert [op.id for op in OPERATIONS if not hasattr(LabClient, op.client.name)] == []


def test_ends_of_runs_are_those_of_the_core() -> None:
    assert _runs.RUN_ENDS == RUN_ENDS
    assert (_batches.MOST_RUNS, _batches.MOST_FILES) == (MOST_RUNS, MOST_FILES)


@pytest.mark.parametrize(("cls", "twin"), [(LabClient, AsyncLabClient), (Experiment, AsyncExperiment)])
def test_the_twin_has_the_same_methods_with_the_same_parameters(cls: type, twin: type) -> None:
    for name, member in inspect.getmembers(cls, inspect.isfunction):
        if name.startswith("_") and name != "__init__":
            continue
        ours, theirs = inspect.signature(member), inspect.signature(getattr(twin, name))
        said = [str(p).replace("'Async", "'") for p in theirs.parameters.values()]
        assert said == [str(p) for p in ours.parameters.values()], name
    public = {name for name in dir(twin) if not name.startswith("_")}
    assert public - {name for name in dir(cls) if not name.startswith("_")} <= set(vars(make(cls)))


def make(cls: type) -> object:
    lab = LabClient("http://127.0.0.1:9")
    return lab if cls is LabClient else Experiment(lab, "name", "ada")


def test_importing_the_client_loads_neither_kernel_nor_server() -> None:
    code = "import labos.client, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = ("labos.runtime", "labos.http", "labos.store", "labos.planning", "starlette", "sqlalchemy")
    assert [name for name in done.stdout.split() if name.startswith((*heavy, "pandas", "zenoh"))] == []


def test_a_table_that_is_left_out_of_a_change_is_not_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    """``amend_campaign`` without ``consumables`` leaves their limits as they are."""
    sent: list[Any] = []

    def note(self: LabClient, method: str, path: str, **options: Any) -> dict[str, Any]:
        sent.append((method, path, msgspec.json.decode(options["content"])))
        return {"terms": {}, "run": "R1"}

    monkeypatch.setattr(LabClient, "_ask", note)
    lab = LabClient("http://127.0.0.1:9")
    lab.amend_campaign("C1", "ada", priority=5)
    (amended,) = sent
    assert amended[:2] == ("POST", "/campaigns/C1/amend")
    assert amended[2].items() >= {"by": "ada", "priority": 5, "consumables": None}.items()
    assert "campaign" not in amended[2]
    lab.submit({"text": "", "name": "empty"}, user="ada")
    assert sent[1][2]["payload"] == {}
