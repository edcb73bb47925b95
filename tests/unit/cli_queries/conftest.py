"""A lab at rest, and commands that ask it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from labos.errors import LabosError
from tests.unit.services.logbook import two_users

Ask = Callable[..., Result]


def command_of(name: str) -> Any:
    module = __import__(f"labos.cli.{name}", fromlist=["command"])
    return getattr(module, "command", None) or getattr(module, name)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A lab at rest: two users' day."""
    two_users().save(tmp_path / "lab")
    return tmp_path / "lab"


@pytest.fixture
def ask(home: Path, monkeypatch: pytest.MonkeyPatch) -> Ask:
    """Runs a command against the home; an expected error becomes exit code 1 and its words."""
    monkeypatch.setenv("TZ", "UTC")
    monkeypatch.setenv("LABOS_HOME", str(home))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)

    def ask_(name: str, *args: str, code: int = 0) -> Result:
        result = CliRunner().invoke(command_of(name), args)
        if isinstance(result.exception, LabosError):
            assert code == 1, result.exception
            assert str(result.exception).count("\n") == 0
            result.stdout_bytes = str(result.exception).encode()
        else:
            if result.exception is not None and not isinstance(result.exception, SystemExit):
                raise result.exception
            assert result.exit_code == code, result.output
        return result

    return ask_
