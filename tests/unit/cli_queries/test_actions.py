"""What modules can do, and what somebody may have meant who mistypes a command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from labos.cli.app import COMMANDS, group
from labos.errors import NotFound
from tests.unit.services.logbook import two_users

CELL = """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - name: shaker
    model: our_shaker
    interface: wei_rest_node
    config: {rest_node_address: "http://127.0.0.1:2000"}
    about:
      actions:
        shake:
          description: Shake what stands on it.
          args:
            speed: {type: int, unit: rpm, minimum: 100, maximum: 2000}
            back: {type: bool, default: false}
"""


def call(*argv: str, code: int = 0) -> Result:
    result = CliRunner().invoke(group, argv)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(autouse=True)
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LABOS_HOME", raising=False)
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)


def test_where_there_is_no_lab_it_tells_of_the_drivers() -> None:
    told = call("actions").stdout
    assert "sciclops" in told
    assert "get_plate" in told


def test_an_action_with_its_arguments_units_and_ranges() -> None:
    told = call("actions", "a4s_sealer", "seal").stdout
    assert "seal: Seal the plate in the nest. About 25 s." in told
    assert "a number from 50 to 200 °C, 175.0 if not given (also temp)." in told
    assert "reset" not in told
    (driver,) = json.loads(call("actions", "A4S_sealer", "--json").stdout)
    temperature = next(a for a in driver["actions"][0]["args"] if a["name"] == "temperature")
    assert (temperature["unit"], temperature["minimum"], temperature["maximum"]) == ("°C", 50, 200)


def test_the_modules_of_a_file_with_what_is_written_of_them(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL, encoding="utf-8")
    told = call("actions", "--workcell", "corner.yaml").stdout
    assert "left" in told
    assert "shaker" in told
    told = call("actions", "shaker", "--workcell", "corner.yaml").stdout
    assert "shake: Shake what stands on it." in told
    assert "a whole number from 100 to 2000 rpm." in told
    assert "true or false, false if not given." in told


def test_the_modules_of_a_lab(tmp_path: Path) -> None:
    two_users().save(tmp_path / "lab")
    told = json.loads(call("actions", "--json").stdout)
    assert {offer["name"] for offer in told} != {offer["driver"] for offer in told}
    drivers = json.loads(call("actions", "--json", "--drivers").stdout)
    assert {offer["name"] for offer in drivers} == {offer["driver"] for offer in drivers}


def test_no_line_is_longer_than_a_page() -> None:
    lines = call("actions", "pf400").stdout.splitlines()
    assert max(map(len, lines[1:])) <= 100


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("sealerr",), "Did you mean 'a4s_sealer'?"),
        (("sciclops", "get_plates"), "sciclops has no action 'get_plates'. Did you mean 'get_plate'?"),
    ],
)
def test_unknown_names_are_asked_back(argv: tuple[str, ...], words: str) -> None:
    with pytest.raises(NotFound) as told:
        call("actions", *argv)
    assert words in str(told.value)


# -- commands ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("runz",), "There is no command 'runz'. Did you mean 'run' or 'runs'?"),
        (("status",), "Did you mean 'runs'?"),
        (("Validate", "x.yaml"), "Did you mean 'validate'?"),
        (("node", "strat"), "There is no command 'strat'. Did you mean 'start' or 'trace'?"),
        (("xyzzy",), "There is no command 'xyzzy'."),
    ],
)
def test_a_mistyped_command_is_asked_back(argv: tuple[str, ...], words: str) -> None:
    assert words in call(*argv, code=2).stderr


def test_the_help_has_each_command_once_under_a_heading() -> None:
    told = call("--help").stdout
    for heading in ("A lab:", "Workflows:", "Runs and experiments:", "Modules:", "The bench:", "The log:"):
        assert f"\n{heading}\n" in told
    names = [line.split()[0] for line in told.splitlines() if line.startswith("  ") and line[2:3].isalpha()]
    assert all(names.count(name) == 1 for name in COMMANDS)
