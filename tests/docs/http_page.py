"""The generated parts of the page on HTTP, from the operations that the server offers."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from labos.http.openapi import about, parameters
from labos.http.operation import Operation
from labos.http.problems import PROBLEMS
from labos.http.routes import OPERATIONS

Table = Callable[[tuple[str, ...], Iterable[tuple[str, ...]]], str]


def http(table: Table) -> str:
    """Every operation: what it reads, what it answers, what may go wrong."""
    return "\n".join(_operation(operation, table) for operation in OPERATIONS)


def problems(table: Table) -> str:
    """Every code, with its status."""
    rows = [(f"`{code}`", str(kind.status), kind.title) for code, kind in PROBLEMS.items()]
    return table(("code", "status", "meaning"), rows) + "\n"


def operations(table: Table) -> str:
    """All operations at a glance, with the permission that each needs."""
    rows = [
        (f"[{op.method} {op.path}](#{_anchor(op)})", op.summary, f"`{op.id}`", op.needs) for op in OPERATIONS
    ]
    return table(("operation", "what it does", "id", "needs"), rows) + "\n"


def _anchor(operation: Operation) -> str:
    heading = f"{operation.method} {operation.path}".lower()
    return "".join(char for char in heading.replace(" ", "-") if char.isalnum() or char in "-_")


def _operation(operation: Operation, table: Table) -> str:
    parts = [f"## {operation.method} {operation.path}", f"{operation.summary}. {_one_line(about(operation))}"]
    asked = [
        (f"`{found['name']}`", found["in"], found["description"])
        for found in parameters(operation)
        if found["name"] != "Idempotency-Key"
    ]
    if asked:
        parts.append(table(("parameter", "in", "meaning"), asked))
    if operation.shape.body is not None:
        parts.append(table(("field", "", "meaning"), _fields(operation.shape.body)))
    if operation.example is not None:
        parts.append(f"```json\n{json.dumps(operation.example, ensure_ascii=False)}\n```")
    parts.append(_answer(operation))
    if operation.problems:
        codes = ", ".join(f"`{code}`" for code in operation.problems)
        parts.append(f"Problems besides those of every request: {codes}.")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _fields(kind: type[msgspec.Struct]) -> list[tuple[str, ...]]:
    _, components = msgspec.json.schema_components([kind])
    meanings = components[kind.__name__]["properties"]
    return [
        (
            f"`{field.encode_name}`",
            "required" if field.required else "",
            meanings[field.encode_name].get("description", ""),
        )
        for field in msgspec.structs.fields(kind)
    ]


def _answer(operation: Operation) -> str:
    kind: Any = operation.shape.answer
    if kind in (str, bytes):
        return f"Answers {operation.status}, `{operation.media[0]}`."
    fields = ", ".join(f"`{field.encode_name}`" for field in msgspec.structs.fields(kind))
    own = kind.__doc__ or ""
    words = _one_line(inspect.cleandoc(own)) if not own.startswith(f"{kind.__name__}(") else ""
    text = f"Answers {operation.status}" + (f" with {fields}. " if fields else ". ")
    text = (text + words).strip()
    if operation.example_answer:
        text += f"\n\n```json\n{json.dumps(operation.example_answer, ensure_ascii=False)}\n```"
    return text


def _one_line(text: str) -> str:
    return " ".join(text.replace("``", "`").split())
