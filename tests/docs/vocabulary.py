"""The words that a reader of the commands' help, the pages' headings and the metrics' names meets."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from labos.core.state import LabState
from labos.telemetry.kernel import KernelMetrics
from labos.telemetry.node import NodeMetrics
from tests.docs.generate import commands
from tests.docs.markdown import DOCS, headings, table

PLAIN = DOCS.parent / "tests" / "docs" / "plain_words.txt"
GLOSSARY = DOCS / "glossary.md"

_CODE = re.compile(r"`[^`]*`|\[[^\]]*\]\([^)]*\)|https?:\S+|\S*[/=_.]\w\S*|--\S+")
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9+-]*[A-Za-z0-9+]")


def words_of(text: str) -> Iterator[str]:
    """The words of a text in lower case, without code; what joins two words by a dash is two words."""
    for word in _WORD.findall(_CODE.sub(" ", text)):
        for part in word.split("-"):
            if len(part) > 2 and part in (part.lower(), part.capitalize()):
                yield part.lower()


def base_forms(word: str) -> Iterator[str]:
    """The word, and what it may be a form of: ``steps``, ``tries``, ``stopped``, ``moving``."""
    yield word
    for ending, put in (
        *(("ies", "y"), ("ied", "y"), ("es", ""), ("es", "e"), ("s", "")),
        *(("ed", ""), ("ed", "e"), ("ing", ""), ("ing", "e"), ("er", ""), ("er", "e"), ("ly", "")),
    ):
        if word.endswith(ending) and len(word) > len(ending) + 2:
            stem = word[: -len(ending)]
            yield stem + put
            if len(stem) > 3 and stem[-1] == stem[-2]:
                yield stem[:-1]


def find_used_words() -> dict[str, str]:
    """Each word, and one place where it is used."""
    found: dict[str, str] = {}

    def note(text: str, place: str) -> None:
        for word in words_of(text):
            found.setdefault(word, place)

    for name, command, _ in commands():
        prose = [
            line for line in (command.help or "").splitlines() if not re.search(r" {3,}\S|^\s*labos ", line)
        ]
        note("\n".join(prose), f"the help of {name}")
        for parameter in command.params:
            note(getattr(parameter, "help", None) or "", f"the help of {name}, {parameter.opts[0]}")
    for page in (*sorted(DOCS.glob("*.md")), *sorted((DOCS / "runbooks").glob("*.md"))):
        for heading in headings(page.read_text()):
            note(heading, f"a heading of {page.relative_to(DOCS)}")
    node = NodeMetrics("driver", "1", simulated=True)
    for metric in (*KernelMetrics(LabState).registry.families, *node.families):
        note(metric.name.replace("_", " "), f"the metric {metric.name}")
        note(metric.help, f"the metric {metric.name}")
    return found


def find_explained_words() -> set[str]:
    """The words of all terms of the glossary, and of its paragraph on other programs."""
    text = GLOSSARY.read_text()
    terms = " ".join(row[0] for row in table(text)) + text.partition("## Standards and programs")[2]
    return {word.lower() for word in re.findall(r"[A-Za-z][A-Za-z0-9+]*", terms)}


def find_unexplained(used: Iterable[str], known: set[str]) -> list[str]:
    return sorted(word for word in used if not known & set(base_forms(word)))
