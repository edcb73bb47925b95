"""Options that several commands share, and what they mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

home_option = click.option(
    "--home", metavar="DIR", help="The lab's folder (LABOS_HOME; ./lab if neither is given)."
)
database_option = click.option(
    "--database",
    metavar="URL",
    help="sqlite:///file or postgresql://… (LABOS_DATABASE_URL; a file in the home folder).",
)
json_option = click.option("--json", "as_json", is_flag=True, help="JSON, for programs.")
user_option = click.option(
    "--user", envvar="LABOS_USER", metavar="NAME", help="Who asks (LABOS_USER; your login if not given)."
)


def lab_options(command: F) -> F:
    """Options of commands that may run a kernel themselves."""
    for option in reversed(
        (
            home_option,
            database_option,
            click.option("--speed", type=click.FloatRange(min=0.01), help="Simulated time, times real time."),
            click.option("--seed", type=int, default=0, help="For the jitter of simulated instruments."),
        )
    ):
        command = option(command)
    return command


def who(user: str | None) -> str:
    """The user's name: as given, else the login."""
    if user:
        return user
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "somebody"
