"""State machines as Mermaid diagrams, and the pages of reasons and questions."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import get_args

import msgspec

from labos.core.reasons import AnyReason
from labos.core.topics import AnyTopic
from tests.support.machines import MACHINES, Transition, list_arrows
from tests.support.topics import TOPICS

Table = Callable[[tuple[str, ...], Iterable[tuple[str, ...]]], str]


def machines() -> str:
    """One drawing for each machine."""
    return "\n".join(
        f"## {name.capitalize()}\n\n```mermaid\n{draw_arrows(rows)}\n```\n" for name, rows in MACHINES.items()
    )


def draw_arrows(rows: tuple[Transition, ...]) -> str:
    """Arrows between two statuses are one, named by all their events."""
    found: dict[tuple[str, str], list[str]] = {}
    for event, before, after in list_arrows(rows):
        found.setdefault((before, after), []).append(event)
    lines = [
        f"    {_node(before)} --> {_node(after)}: {', '.join(dict.fromkeys(events))}"
        for (before, after), events in found.items()
    ]
    return "\n".join(["stateDiagram-v2", *lines])


def _node(status: str) -> str:
    return status.replace(" ", "_") or "[*]"


def waits(table: Table) -> str:
    """Every reason why a step does not start."""
    rows = [
        (
            f"`{kind.__struct_config__.tag}`",
            _mark_names(kind.SENTENCE),
            _mark_names(kind.REMEDY) or ("by status, see below" if "remedy" in vars(kind) else ""),
            "it passes by itself" if kind.PASSES else "a person has to act",
            ", ".join(kind.WAKES),
        )
        for kind in get_args(AnyReason)
    ]
    head = (
        "reason",
        "what it says",
        "what a person can do",
        "who ends it",
        "looked at again when this changes",
    )
    return table(head, rows) + "\n"


def _mark_names(template: str) -> str:
    """A sentence with its names in capitals."""
    words = template.replace("!r}", "}")
    for part in template.split("{")[1:]:
        name = part.partition("}")[0].removesuffix("!r")
        words = words.replace(f"{{{name}}}", name.upper())
    return words


def questions(table: Table) -> str:
    """Every type of question: its fields, and what may be answered, with names as in an example."""
    parts = []
    for kind in get_args(AnyTopic):
        fields = ", ".join(f"`{field.name}`" for field in msgspec.structs.fields(kind))
        words = " ".join(inspect.cleandoc(kind.__doc__ or "").replace("``", "`").split())
        known = {choice: True for topic in TOPICS if type(topic) is kind for choice in topic.choices}
        choices = table(("answer", "what follows"), ((f"`{c.name}`", c.consequence) for c in known))
        parts.append(
            f"### {kind.__struct_config__.tag}\n\n{words}\n\n"
            f"Kind `{kind.KIND}`; fields {fields}.\n\n{choices}\n"
        )
    return "\n".join(parts)
