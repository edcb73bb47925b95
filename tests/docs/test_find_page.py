"""The page about finding and sharing: each command answers what is told."""

from __future__ import annotations

import json
import shlex
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.cli.app import main
from tests.docs.markdown import DOCS, blocks
from tests.docs.test_tutorial import check_output
from tests.support.published import PICTURE_CONTENT, save_published

PAGE = DOCS / "find-and-share.md"


@pytest.fixture
def utc() -> Iterator[None]:
    """Times as the page shows them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "UTC")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("utc")
def test_every_command_answers_what_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save_published(tmp_path / "lab")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    for name in ("LABOS_DATABASE_URL", "LABOS_URL"):
        monkeypatch.delenv(name, raising=False)
    said, checked = "", 0
    capsys.readouterr()
    for block in blocks(PAGE.read_text()):
        if block.language == "bash":
            for line in block.text.splitlines():
                assert main(shlex.split(line)[1:]) == 0, line
            said = capsys.readouterr().out
        elif block.language == "text" and said:
            check_output(block.text, said, f"{PAGE.name}:{block.line}")
            checked += 1
            said = ""
    assert checked == 5
    with zipfile.ZipFile("E1.zip") as crate:
        assert PICTURE_CONTENT in [crate.read(name) for name in crate.namelist()]
    lines = Path("events.jsonl").read_text().splitlines()
    assert [int(json.loads(line)["position"]) for line in lines] == list(range(1, len(lines) + 1))
