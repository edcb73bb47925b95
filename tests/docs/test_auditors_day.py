"""The page of an auditor's day: each command is carried out, and says what the page says."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from labos.cli.app import main
from labos.core.ids import RunId
from labos.core.signatures import RunSigned, make_digest_of_records
from tests.docs.markdown import DOCS, blocks
from tests.docs.test_tutorial import check_output
from tests.support.audited import audit_lab

PAGE = DOCS / "auditors-day.md"


def test_the_day_goes_as_the_page_tells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    book = audit_lab()
    envelopes = [record.envelope for record in book.records if record.head.stream == "R3"]
    digest = make_digest_of_records(envelopes)
    signed = RunSigned(RunId("R3"), "ada", "reviewed", len(envelopes), digest, "password", "volumes checked")
    book.write([signed], "ada")
    book.save(tmp_path / "lab")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    assert main(["key", "create", "--name", "chem.example.org/lab1"]) == 0
    Path("lab.pub").write_text(capsys.readouterr().out)
    assert main(["checkpoint"]) == 0
    shutil.copytree("lab/checkpoints", "elsewhere")
    capsys.readouterr()
    said, asked = "", 0
    for block in blocks(PAGE.read_text()):
        if block.language == "bash":
            for line in block.text.splitlines():
                assert main(shlex.split(line)[1:]) == 0, (line, capsys.readouterr())
            said = capsys.readouterr().out
        else:
            check_output(block.text, said, f"{PAGE.name}:{block.line}")
            asked += 1
    assert asked >= 10
