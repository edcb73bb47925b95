"""The page of an auditor's questions: each is asked, and its answer is the one that is told."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from labos.cli.app import main
from tests.docs.markdown import DOCS, blocks
from tests.docs.test_tutorial import check_output
from tests.support.audited import audit_lab

PAGE = DOCS / "provenance.md"


def test_every_question_has_the_answer_that_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    audit_lab().save(tmp_path / "lab")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    said, asked = "", 0
    for block in blocks(PAGE.read_text()):
        if block.language == "sql":
            calls = [["sql", block.text]]
        elif block.language == "bash":
            calls = [shlex.split(line)[1:] for line in block.text.splitlines()]
        else:
            if said:
                check_output(block.text, said, f"{PAGE.name}:{block.line}")
                asked += 1
            said = ""
            continue
        for call in calls:
            assert main(call) == 0, call
        said = capsys.readouterr().out
    assert asked >= 14
