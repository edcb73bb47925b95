"""The glossary explains what help texts, headings and metrics say, and everybody spells alike."""

from __future__ import annotations

import ast
import re

import pytest

from labos.cli.app import group
from tests.docs import vocabulary
from tests.docs.markdown import DOCS, ROOT, prose, table

STANDARD = (
    *("interlock", "dispatch", "reservation", "deadlock avoidance", "lease", "fencing", "work in progress"),
    *("auto-resolved", "speed-up factor", "module", "node", "adapter", "driver", "link", "description"),
    *("workcell", "station", "labware", "location", "action", "step", "workflow", "run", "experiment"),
    *("campaign", "payload", "intervention", "lab", "kernel", "epoch", "observe", "unavailable"),
)

AMERICAN = re.compile(
    r"\b(colors?|behaviors?|neighbors?|favor\w*|honor\w*|labor|catalogs?|center(ed|s)?|fibers?|gray|canceled|"
    r"canceling|labeled|labeling|modeled|modeling|signaled|traveled|defense|judgment|analyz\w+|catalyz\w+|"
    r"(author|initial|serial|summar|recogn|organ|synchron|normal|optim|util|minim|maxim|real|special|standard|"
    r"stabil|final|general|visual|central|custom|emphas|motor)iz(e|es|ed|er|ers|ing|ation|ations))\b",
    re.IGNORECASE,
)
"""Words that have another spelling in British English, in which LabOS writes."""

OTHERS = r"\b[Cc]olor (picker|mixing)|Modbus Organization|\b[Aa]uthorization|\bauthorizer"
CODE = re.compile(r"`[^`]*`|\"[^\"]*\"|\S*[/_=.]\S+|^ {4,}\S.*$|" + OTHERS, re.MULTILINE)
"""Code, what is quoted, and names that others gave."""


def terms() -> set[str]:
    return {term.strip() for row in table(vocabulary.GLOSSARY.read_text()) for term in row[0].split(",")}


def test_the_standard_terms_are_explained() -> None:
    assert [term for term in STANDARD if term not in terms()] == []


def test_every_term_stands_once() -> None:
    rows = [row[0] for row in table(vocabulary.GLOSSARY.read_text())]
    assert sorted({row for row in rows if rows.count(row) > 1}) == []


def test_every_word_is_plain_or_explained() -> None:
    used = vocabulary.find_used_words()
    known = vocabulary.find_explained_words() | set(vocabulary.PLAIN.read_text().split())
    found = {word: used[word] for word in vocabulary.find_unexplained(used, known)}
    assert found == {}, (
        "explain them in docs/glossary.md; what everybody knows goes to tests/docs/plain_words.txt"
    )


def test_a_new_technical_word_is_noticed() -> None:
    known = vocabulary.find_explained_words() | set(vocabulary.PLAIN.read_text().split())
    assert vocabulary.find_unexplained(vocabulary.words_of("Quiesce the apparatus, then steps."), known) == [
        "apparatus",
        "quiesce",
    ]


def test_the_plain_words_are_not_terms() -> None:
    plain = vocabulary.PLAIN.read_text().split()
    assert plain == sorted(set(plain))
    assert sorted(set(plain) & {term.lower() for term in terms()}) == []


@pytest.mark.parametrize(
    "page",
    ["architecture.md", "people.md", "tutorial-first-instrument.md", "torture.md", "proof.md", "install.md"],
)
def test_pages_lead_to_the_glossary(page: str) -> None:
    assert "(glossary.md" in (DOCS / page).read_text()


def test_the_help_leads_to_the_glossary() -> None:
    assert "docs/glossary.md" in (group.help or "")


def test_the_spelling_is_british() -> None:
    """In pages, in docstrings and in the help. Names of other programs stay as they are."""
    texts = {path: "\n".join(line for _, line in prose(path.read_text())) for path in DOCS.rglob("*.md")}
    for path in (*(ROOT / "labos").rglob("*.py"), *(ROOT / "drivers").rglob("*.py")):
        nodes = ast.walk(ast.parse(path.read_text()))
        documented = [node for node in nodes if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)]
        texts[path] = "\n".join(ast.get_docstring(node) or "" for node in documented)
    found = {
        str(path.relative_to(ROOT)): [word[0] for word in AMERICAN.finditer(CODE.sub("", text))]
        for path, text in texts.items()
    }
    assert {path: words for path, words in found.items() if words} == {}
