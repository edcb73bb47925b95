"""Help texts and pages are made of plain sentences: subject, verb, object.

Readers whose first language is another one stumble over some forms: a sentence whose subject is a clause with
*who* or *what*, one that begins with *Of*, *whoever*, and *told* where something is reported or configured.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.cli.app import COMMANDS
from tests.docs.generate import commands
from tests.docs.markdown import DOCS, ROOT, prose

OPENING = re.compile(
    r"(?:^|(?<=[.!;:] ))(?:(?:Who|Whom|Whose|Whoever|What|Whatever) [^.?]*(?:[.]|$)|Of (?!course\b)[a-z])"
)
"""A sentence that begins with a clause as its subject, or with *Of*; a question may begin so."""

WORDS = re.compile(r"\bwhoever\b|\bwhomever\b|\bfor ever\b|\b(?:is|are|was|were) told\b", re.IGNORECASE)

CODE = re.compile(r"`[^`]*`|\]\([^)]*\)")

PAGES = [
    *sorted(DOCS.glob("*.md")),
    *sorted((DOCS / "runbooks").glob("*.md")),
    *sorted((DOCS / "drivers").glob("*.md")),
    *sorted((DOCS / "decisions").glob("*.md")),
    *sorted((DOCS / "reference").glob("*.md")),
    *sorted((ROOT / "specs").rglob("README.md")),
    ROOT / "CHANGELOG.md",
    ROOT / "README.md",
]


def find_in(text: str) -> Iterator[str]:
    plain = CODE.sub("x", text)
    for pattern in (OPENING, WORDS):
        yield from (found[0] for found in pattern.finditer(plain))


def find_in_page(page: Path) -> list[str]:
    """The forms in a page, paragraph by paragraph; headings, tables' first rows and code are left out."""
    lines = [line for _, line in prose(page.read_text()) if not line.startswith("#")]
    paragraphs = re.split(r"\n\s*\n|\n(?=[-*|] |\d+\. )", "\n".join(lines))
    return [
        found for text in paragraphs for found in find_in(" ".join(text.split()).lstrip("-*|>0123456789. "))
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages(page: Path) -> None:
    assert find_in_page(page) == [], "write it again: subject, verb, object"


def test_help() -> None:
    texts = dict(COMMANDS)
    for name, command, _ in commands():
        texts[name] = (command.help or "").replace("\b", "")
        for parameter in command.params:
            texts[f"{name} {parameter.opts[0]}"] = getattr(parameter, "help", None) or ""
    found = {
        name: list(find_in(" ".join(part.split())))
        for name, text in texts.items()
        for part in text.split("\n\n")
    }
    assert {name: forms for name, forms in found.items() if forms} == {}


@pytest.mark.parametrize(
    "text",
    [
        "What is archived stays.",
        "It ends. Who is let in can go on.",
        "Of these, one goes.",
        "the node was told it",
    ],
)
def test_the_forms_are_found(text: str) -> None:
    assert list(find_in(text)) != []


@pytest.mark.parametrize(
    "text", ["Who may see a campaign?", "Show what it holds.", "Of course it does.", "He told a story."]
)
def test_plain_sentences_are_not_found(text: str) -> None:
    assert list(find_in(text)) == []
