"""Writes data as readable YAML with comments; reading it gives the same data.

Short tables and lists are on one line. Texts that YAML would read as another type are quoted.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from labos.spec.source import Path_, name_field

WIDTH = 100
_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_./()+°µ\-]*( [A-Za-z0-9_./()+°µ\-]+)*")
_WORDS = re.compile("yes|no|true|false|on|off|null", re.IGNORECASE)


def to_yaml(
    value: Mapping[str, Any],
    comments: Mapping[str, Sequence[str]] | None = None,
    below: Sequence[str] = (),
) -> str:
    """The table as text. ``comments`` are written above the entry of their field (by ``name_field``). If a
    field has no line of its own, they are above the nearest entry around it. The comments ``below`` are at
    the end. A comment that begins with ``#`` is written as it is; others are broken into lines."""
    emitter = _Emitter(value)
    for field, texts in (comments or {}).items():
        emitter.comments.setdefault(emitter.find_nearest(field), []).extend(texts)
    lines = [*emitter.iterate_lines(), *([""] if below else ()), *_write_comment(below, "")]
    return "".join(f"{line}\n" for line in lines)


class _Emitter:
    def __init__(self, value: Mapping[str, Any]) -> None:
        self.value = value
        self.comments: dict[str, list[str]] = {}
        self.known = set(self._iterate_paths(value, ()))

    def find_nearest(self, field: str) -> str:
        """The field itself, or the innermost field around it that has a line; empty for none."""
        while field and field not in self.known:
            cut = max(field.rfind("."), field.rfind("["))
            field = field[:cut] if cut > 0 else ""
        return field

    def iterate_lines(self) -> Iterator[str]:
        yield from _write_comment(self.comments.get("", []), "")
        block = False
        for number, (key, item) in enumerate(self.value.items()):
            if number and (block or _is_block(item)):
                yield ""
            block = _is_block(item)
            yield from self._write_entry(key, item, (key,), "")

    def _iterate_paths(self, value: Any, path: Path_) -> Iterator[str]:
        if path:
            yield name_field(path)
        if not _is_block(value) and path:
            return
        entries = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, item in entries:
            yield from self._iterate_paths(item, (*path, key))

    def _write_entry(self, key: str, value: Any, path: Path_, indent: str) -> Iterator[str]:
        yield from _write_comment(self.comments.get(name_field(path), []), indent)
        if not _is_block(value):
            yield f"{indent}{write_scalar(key)}: {_write_flow(value)}"
            return
        yield f"{indent}{write_scalar(key)}:"
        yield from self._block(value, path, f"{indent}  ")

    def _block(self, value: Any, path: Path_, indent: str) -> Iterator[str]:
        if isinstance(value, Mapping):
            for key, item in value.items():
                yield from self._write_entry(key, item, (*path, key), indent)
            return
        apart = any(_is_block(item) for item in value)
        for index, item in enumerate(value):
            here = (*path, index)
            if index and apart:
                yield ""
            yield from _write_comment(self.comments.get(name_field(here), []), indent)
            if isinstance(item, Mapping) and item and apart:
                yield from self._write_item(item, here, indent)
            elif not _is_block(item):
                yield f"{indent}- {_write_flow(item)}"
            else:
                yield f"{indent}-"
                yield from self._block(item, here, f"{indent}  ")

    def _write_item(self, item: Mapping[str, Any], path: Path_, indent: str) -> Iterator[str]:
        """A table in a list: its first line begins with the dash."""
        dashed = False
        for line in self._block(item, path, f"{indent}  "):
            if not dashed and line.strip() and not line.lstrip().startswith("#"):
                line, dashed = f"{indent}- {line[len(indent) + 2 :]}", True
            elif not dashed:
                line = f"{indent}{line.strip()}"
            yield line


def write_scalar(value: Any) -> str:
    """A text, number, boolean or null."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError("a number that is not finite cannot be written")
        return repr(value)
    text = str(value)
    if _PLAIN.fullmatch(text) and not _WORDS.fullmatch(text):
        return text
    return '"' + "".join(_escape(char) for char in text) + '"'


def _escape(char: str) -> str:
    if char in '"\\':
        return f"\\{char}"
    if char == "\n":
        return "\\n"
    if char.isprintable():
        return char
    code = ord(char)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _write_flow(value: Any) -> str:
    if isinstance(value, Mapping):
        return (
            "{" + ", ".join(f"{write_scalar(key)}: {_write_flow(item)}" for key, item in value.items()) + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_write_flow(item) for item in value) + "]"
    return write_scalar(value)


def _is_block(value: Any) -> bool:
    """Whether a value needs lines of its own."""
    if isinstance(value, Mapping):
        if any(isinstance(item, Mapping | list | tuple) and item for item in value.values()):
            return True
        return bool(value) and (len(value) > 4 or len(_write_flow(value)) > WIDTH * 0.6)
    if isinstance(value, list | tuple):
        return any(isinstance(item, Mapping | list | tuple) for item in value) or (
            len(_write_flow(value)) > WIDTH and any(isinstance(item, str) for item in value)
        )
    return False


def _write_comment(texts: Sequence[str], indent: str) -> Iterator[str]:
    for text in texts:
        if text.startswith("#"):
            yield indent + " ".join(text.splitlines())
            continue
        for line in textwrap.wrap(" ".join(text.split()), max(WIDTH - len(indent) - 2, 40)):
            yield f"{indent}# {line}"
