"""What a Markdown page holds that a test can hold it to: code blocks, tables, headings, links."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import msgspec

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
REFERENCE = DOCS / "reference"

_FENCE = re.compile(r"```(\w*)\s*(.*)")
_ATTRIBUTE = re.compile(r'(\w+)="([^"]*)"')
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)")


class Block(msgspec.Struct, frozen=True):
    """A fenced block; ``attributes`` stand behind its language, as ``title="file.yaml"``."""

    language: str
    attributes: dict[str, str]
    text: str
    line: int

    @property
    def title(self) -> str:
        return self.attributes.get("title", "")


def pages() -> list[Path]:
    """The README and every page under docs/."""
    return [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def blocks(text: str) -> list[Block]:
    """Fenced code blocks in order."""
    found: list[Block] = []
    opened: tuple[str, dict[str, str], int] | None = None
    inside: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        fence = _FENCE.fullmatch(line)
        if fence and opened is None:
            opened, inside = (fence[1], dict(_ATTRIBUTE.findall(fence[2])), number), []
        elif line == "```" and opened is not None:
            found.append(Block(opened[0], opened[1], "".join(f"{part}\n" for part in inside), opened[2]))
            opened = None
        else:
            inside.append(line)
    assert opened is None, f"the block of line {opened[2]} is not closed"
    return found


def prose(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines outside fenced and indented code."""
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced and not line.startswith("    "):
            yield number, line


def list_indented(text: str) -> list[tuple[int, str]]:
    """Numbered lines of code that is indented by four blanks."""
    fenced, found = False, []
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced and line.startswith("    "):
            found.append((number, line[4:]))
    return found


def spans(text: str) -> list[tuple[int, str]]:
    """Numbered code spans in prose."""
    return [(number, span) for number, line in prose(text) for span in _SPAN.findall(line)]


def links(text: str) -> list[tuple[int, str]]:
    """Numbered targets of links in prose."""
    return [(n, target) for n, line in prose(text) for target in _LINK.findall(_SPAN.sub("", line))]


def headings(text: str) -> list[str]:
    """Headings in order, without their marks."""
    return [line.lstrip("#").strip() for _, line in prose(text) if re.match(r"#+ ", line)]


def anchor(heading: str) -> str:
    """The name by which a heading is linked to, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def section(text: str, heading: str) -> str:
    """The text under a heading, up to the next one of its rank or above. Raises AssertionError."""
    lines = text.splitlines()
    fenced = False
    start = rank = 0
    for number, line in enumerate(lines):
        fenced ^= line.startswith("```")
        marks = re.match(r"(#+) (.*)", line)
        if fenced or not marks:
            continue
        if start and len(marks[1]) <= rank:
            return "\n".join(lines[start:number])
        if not start and marks[2].strip() == heading:
            start, rank = number + 1, len(marks[1])
    assert start, f"there is no heading {heading!r}"
    return "\n".join(lines[start:])


def table(text: str) -> list[list[str]]:
    """The cells of all tables in a text, without their heads."""
    rows: list[list[str]] = []
    head = True
    for line in text.splitlines():
        if not line.startswith("|"):
            head = True
            continue
        cells = [cell.strip().replace(r"\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if set("".join(cells)) <= set("-: "):
            head = False
        elif not head:
            rows.append(cells)
    return rows


def first_codes(text: str) -> list[str]:
    """The first code span of each table row."""
    return [found[1] for row in table(text) if (found := _SPAN.search(row[0]))]
