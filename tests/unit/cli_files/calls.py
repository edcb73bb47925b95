"""Calling a command as a shell would."""

from __future__ import annotations

from click.testing import CliRunner

from labos.cli.app import group


def call(*argv: str, code: int = 0) -> str:
    """What a command prints. Raises what it raises; a wrong exit code is an AssertionError."""
    result = CliRunner().invoke(group, argv)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result.stdout
