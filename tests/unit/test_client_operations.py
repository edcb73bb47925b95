"""The client speaks to the operations that the API declares, and to each of them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import labos.client
from labos.http.routes import OPERATIONS

ASKING = {"_get": "GET", "_fetch": "GET", "_post": "POST", "_request": "", "_ask": ""}
"""The client's own methods that send something; of the last two the first argument is the method."""

NOT_ASKED = {"follow_events"}
"""For browsers; the client asks for pages of events and waits for the next."""


def called() -> set[tuple[str, str]]:
    """Method and path of all that the client asks for; what is filled in is a star."""
    found = set()
    for file in Path(labos.client.__file__).parent.glob("*.py"):
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


def meant(path: str, operation: str) -> bool:
    declared = re.sub(r"\{\w+\}", "*", operation)
    return all(a == b or "*" in (a, b) for a, b in zip(path.split("/"), declared.split("/"), strict=True))


def matches(method: str, path: str) -> list[str]:
    same = [op for op in OPERATIONS if op.method == method and op.path.count("/") == path.count("/")]
    exact = [op.id for op in same if re.sub(r"\{\w+\}", "*", op.path) == path]
    return exact or [op.id for op in same if meant(path, op.path)]


def test_the_client_asks_for_nothing_that_is_not_declared() -> None:
    assert [call for call in called() if not matches(*call)] == []


def test_each_operation_can_be_asked_for_by_the_client() -> None:
    asked = {name for call in called() for name in matches(*call)}
    assert {op.id for op in OPERATIONS} - asked == NOT_ASKED
