"""What goes wrong is told to people and, with ``--json``, to programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.cli.app import main


@pytest.mark.parametrize(
    ("argv", "code", "exit_code"),
    [
        (["runs", "R9", "--json"], "not_found", 1),
        (["import", "nothing", "--json"], "not_found", 1),
        (["runs", "--jsn", "--json"], "misused", 2),
        (["labware", "--at", "yesterday evening", "--json"], "bad_input", 1),
    ],
)
def test_an_error_is_json_where_json_is_asked_for(
    argv: list[str], code: str, exit_code: int, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [] if argv[0] == "import" else ["--home", str(home)]
    assert main([*argv, *where]) == exit_code
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert (told["code"], sorted(told)) == (code, ["code", "details", "error", "remedy"])
    assert told["error"] in said.err


def test_without_it_standard_output_stays_empty(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", "R9", "--home", str(home)]) == 1
    said = capsys.readouterr()
    assert (said.out, "There is no run 'R9'" in said.err) == ("", True)
