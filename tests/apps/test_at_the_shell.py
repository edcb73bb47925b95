"""What the applications say to who starts them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import color_picker
import pcr
import pendant_drop
import polymers
import pytest

from labos.client import LabUnreachable
from labos.client.report import make_parser, run_program
from labos.errors import BadInput
from tests.apps.growth import APP


@pytest.mark.parametrize("app", [polymers, pendant_drop, color_picker, pcr])
def test_what_is_wrong_is_one_line_that_names_the_file(
    app: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = tmp_path / "missing.yaml"
    monkeypatch.setattr("sys.argv", ["app", "--home", str(tmp_path / "lab"), "--payload", str(missing)])
    assert app.main() == 1  # type: ignore[attr-defined]
    told = capsys.readouterr().err
    assert str(missing) in told
    assert "Traceback" not in told


@pytest.mark.parametrize("app", [polymers, pendant_drop, color_picker, pcr])
def test_without_a_lab_it_says_so(
    app: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["app", "--home", str(tmp_path / "lab"), "--patience", "0"])
    assert app.main() == 1  # type: ignore[attr-defined]
    assert "lab" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, ""),
        (LabUnreachable("The lab is away."), 1, "app: The lab is away.\n"),
        (BadInput("It is wrong."), 1, "app: It is wrong.\n"),
    ],
)
def test_what_was_stopped_says_how_it_goes_on(
    error: BaseException,
    code: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    error.add_note("E3 stays open: start the program again with --resume E3.")

    def prepare(given: argparse.Namespace) -> Callable[..., list[str]]:
        assert given.resume == "E3"
        raise error

    monkeypatch.setattr("sys.argv", ["app", "--resume", "E3"])
    assert run_program("app", make_parser("Nothing.", user="ada", out="out"), prepare) == code
    told = f"{said}app: E3 stays open: start the program again with --resume E3.\n"
    assert capsys.readouterr().err == told


@pytest.mark.parametrize("file", ["color_picker", "pcr", "polymers", "pendant_drop", "growth_assay"])
def test_each_can_be_resumed(
    file: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(APP)
    monkeypatch.setattr("sys.argv", [file, "--help"])
    with pytest.raises(SystemExit):
        __import__(file).main()
    assert "--resume E3" in capsys.readouterr().out
