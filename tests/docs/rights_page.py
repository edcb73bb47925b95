"""The tables of who may do what: commands with what they need, and the ways to ask for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from labos.core.decide.rights import RIGHTS
from labos.http.operation import Operation
from labos.http.routes import OPERATIONS
from tests.docs.operation_rights import ASKED_BY, GIVES

Table = Callable[[tuple[str, ...], Iterable[tuple[str, ...]]], str]


def rights(table: Table) -> str:
    """Every command that somebody may ask for, then those of LabOS itself."""
    rows, inside = [], []
    for command, right in RIGHTS.items():
        if right.role is None:
            inside.append(f"`{command.__name__}`")
            continue
        ways = [op for op in OPERATIONS if command in GIVES.get(op.id, ())]
        rows.append((f"`{command.__name__}`", right.role, right.words, _routes(ways), _list_asked(ways)))
    head = ("command", "least role", "who may", "HTTP", "`labos`")
    return f"{table(head, rows)}\n\nAsked for by LabOS itself only: {', '.join(sorted(inside))}.\n"


def routes(table: Table) -> str:
    """Every operation that gives no command."""
    rows = [(_route(op), op.needs, _list_asked([op])) for op in OPERATIONS if op.id not in GIVES]
    return table(("HTTP", "least role", "`labos`"), rows) + "\n"


def _routes(ways: list[Operation]) -> str:
    return ", ".join(map(_route, ways))


def _route(operation: Operation) -> str:
    return f"`{operation.method} {operation.path}`"


def _list_asked(ways: list[Operation]) -> str:
    names = dict.fromkeys(name for op in ways for name in ASKED_BY.get(op.id, ()))
    return ", ".join(f"`{name}`" for name in names)
