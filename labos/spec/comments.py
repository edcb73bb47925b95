"""Comments of a foreign file, and their places in the rewritten file."""

from __future__ import annotations

import bisect
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import yaml

from labos.spec.source import Path_, SourceList, SourceMapping, name_field

_COMMENT = re.compile(r"(^|\s)(#.*)$")


class Comment(NamedTuple):
    """A comment as it was written, from its ``#``. ``is_alone``: its line has nothing else."""

    line: int
    text: str
    is_alone: bool


def read_comments(text: str) -> list[Comment]:
    """The comments of a YAML text that can be read, from top to bottom; empty ones are left out."""
    covered = list(text)
    for token in yaml.scan(text):
        if isinstance(token, yaml.ScalarToken):
            for index in range(token.start_mark.index, token.end_mark.index):
                covered[index] = "\n" if covered[index] == "\n" else "x"
    found = []
    for number, (line, written) in enumerate(
        zip("".join(covered).split("\n"), text.split("\n"), strict=True), start=1
    ):
        if (match := _COMMENT.search(line)) and written[match.start(2) :].strip("# \t\r"):
            kept = written[match.start(2) :].rstrip()
            found.append(Comment(number, kept, not line[: match.start(2)].strip()))
    return found


def place_comments(comments: list[Comment], form: SourceMapping) -> tuple[dict[str, list[str]], list[str]]:
    """The comments by the field of the ``form`` to which they belong. A comment behind an entry belongs to
    this entry. A comment on a line of its own belongs to the next entry. Comments above everything belong to
    the whole file (``""``). The second list has the comments below everything."""
    fields = dict[int, str]()
    for line, path in _iterate_lines(form, ()):
        fields.setdefault(line, name_field(path))
    lines = sorted(fields)
    placed, below = dict[str, list[str]](), list[str]()
    for comment in comments:
        index = bisect.bisect_right(lines, comment.line) - (0 if comment.is_alone else 1)
        if index >= len(lines):
            below.append(comment.text)
        else:
            field = "" if index < 0 or (comment.is_alone and not index) else fields[lines[index]]
            placed.setdefault(field, []).append(comment.text)
    return placed, below


def _iterate_lines(value: Any, path: Path_) -> Iterator[tuple[int, Path_]]:
    """The lines of the entries of a form, the outer entries first."""
    if isinstance(value, SourceMapping):
        for key, item in value.items():
            if line := value.keys_at.get(key, value.at).line:
                yield line, (*path, key)
            yield from _iterate_lines(item, (*path, key))
    elif isinstance(value, SourceList):
        for index, item in enumerate(value):
            if index < len(value.values_at) and (line := value.values_at[index].line):
                yield line, (*path, index)
            yield from _iterate_lines(item, (*path, index))
