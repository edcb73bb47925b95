"""What the applications say to who starts them."""

from __future__ import annotations

from pathlib import Path

import color_picker
import pcr
import pendant_drop
import polymers
import pytest


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
