"""Every page: its links lead somewhere, and the commands it quotes exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import click
import pytest

from labos.cli.app import group
from labos.errors import BadInput
from tests.docs.markdown import ROOT, anchor, blocks, headings, links, list_indented, pages, spans

_CALL = re.compile(r"(?:^|[\s/;&|])labos(?= )")


def all_pages() -> list[Any]:
    return [pytest.param(page, id=str(page.relative_to(ROOT))) for page in pages()]


@pytest.mark.parametrize("page", all_pages())
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for number, target in links(page.read_text()):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, name = unquote(target).partition("#")
        found = page.parent / path if path else page
        if not found.exists():
            broken.append(f"{number}: {target}: no such file")
        elif name and name not in map(anchor, headings(found.read_text())):
            broken.append(f"{number}: {target}: no such heading")
    assert broken == []


@pytest.mark.parametrize("page", all_pages())
def test_quoted_commands_exist(page: Path) -> None:
    text = page.read_text()
    whole = list_indented(text)
    for block in blocks(text):
        if block.language in ("bash", "text", ""):
            whole += [(block.line + n, line) for n, line in enumerate(block.text.splitlines(), 1)]
    wrong = [f"{n}: {line}: {why}" for n, line in whole if (why := what_is_wrong(line, strict=True))]
    wrong += [f"{n}: {span}: {why}" for n, span in spans(text) if (why := what_is_wrong(span, strict=False))]
    assert wrong == []


def what_is_wrong(line: str, *, strict: bool) -> str:
    """Why the calls of ``labos`` in a line of code cannot be; in prose a call may lack arguments,
    and ``…`` stands for more of them."""
    if strict and not re.match(r"labos |.*/labos ", line):
        return ""  # what was printed, not what was typed
    line = re.split(r"\s{2,}|\s#\s", line)[0]
    for part in re.split(r"&&|;|\||(?<!\S)&(?!\S)|>", line) if not strict else _commands(line):
        call = _CALL.search(part)
        if call and (why := _refusal(shlex.split(part[call.end() :]), strict=strict)):
            return why
    return ""


def _commands(line: str) -> list[str]:
    """The commands of a shell line: what is quoted is not cut."""
    lexer = shlex.shlex(line, posix=False, punctuation_chars=";&|>")
    lexer.whitespace_split = True
    parts: list[list[str]] = [[]]
    for token in lexer:
        if set(token) <= set(";&|>"):
            parts.append([])
        else:
            parts[-1].append(token)
    return [" ".join(part) for part in parts]


def _refusal(words: list[str], *, strict: bool) -> str:
    """What click says against a call; empty if it would take it."""
    words = [word for word in words if "…" not in word and word != "..."]
    command: click.Command = group
    context = click.Context(group, info_name="labos")
    try:
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            _, found, words = command.resolve_command(context, words)
            assert found is not None
            command, context = found, click.Context(found, info_name=found.name, parent=context)
        if isinstance(command, click.Group) and not command.invoke_without_command:
            return "" if not words or words[0] in ("--help", "-h", "--version") else f"no command {words[0]}"
        if "--help" not in words:
            command.make_context(command.name, words, parent=context.parent)
    except click.MissingParameter as error:
        return error.format_message() if strict else ""
    except click.UsageError as error:
        return error.format_message()
    except BadInput as error:
        return str(error) if strict else ""  # prose says TIME where a time stands
    return ""


@pytest.mark.parametrize(
    "line",
    [
        "labos lgo --last 3",
        "labos log --lsat 3",
        "labos log --last",
        "labos db stauts",
        "labos explain R1 R2",
    ],
)
def test_a_command_that_does_not_exist_is_noticed(line: str) -> None:
    assert what_is_wrong(line, strict=False)
    assert what_is_wrong(f".venv/bin/{line} && true", strict=True)


def test_a_command_that_exists_is_none() -> None:
    assert not what_is_wrong('labos submit pcr --payload \'{"a": "b > c; d"}\' --wait | tail -1', strict=True)
    assert not what_is_wrong("labos explain", strict=False)
    assert what_is_wrong("labos explain", strict=True)


def test_pip_is_not_told_to_be_quiet_where_a_newcomer_waits_for_it() -> None:
    """It takes minutes, in which it says what it does."""
    readme = (ROOT / "README.md").read_text()
    demo = readme.partition("<!-- demo -->")[2].partition("<!-- end -->")[0]
    assert "pip install . " in demo
    assert not re.search(r"\s-(q|-quiet)\b", demo)
