"""Options that several commands share."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import msgspec

from labos.cli._out import note_json
from labos.cli._remote import expect_folder, is_given
from labos.errors import BadInput

if TYPE_CHECKING:
    from labos.client import LabClient

F = TypeVar("F", bound=Callable[..., Any])

SPEED_HELP = "Speed-up factor: simulated time divided by real time."
speed_option = click.option(
    "--speed", type=click.FloatRange(min=0.01), help=f"{SPEED_HELP} A new lab has 1 if not given."
)


def options_together(*options: Callable[[Any], Any]) -> Callable[[F], F]:
    """Several options as one, in their order."""

    def add(command: F) -> F:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def refuse_password(context: click.Context, option: click.Parameter, url: str | None) -> str | None:
    """All users of this computer can read the arguments of a command, so they must not contain a password.
    Raises BadInput."""
    from urllib.parse import parse_qs, urlsplit

    parts = urlsplit(url if url and is_given(option.name or "") else "")
    if parts.password or "password" in parse_qs(parts.query):
        raise BadInput(
            "The URL after --database has a password, which all users of this computer can read in the list "
            "of processes.",
            remedy="Put the URL into the variable LABOS_DATABASE_URL.",
        )
    return url


def file_option(*names: str, metavar: str = "FILE", **more: Any) -> Callable[[F], F]:
    """An option that names a file; the command gets a Path."""
    return click.option(*names, type=click.Path(path_type=Path, dir_okay=False), metavar=metavar, **more)


def folder_option(*names: str, metavar: str = "FOLDER", **more: Any) -> Callable[[F], F]:
    """An option that names a folder; the command gets a Path."""
    return click.option(*names, type=click.Path(path_type=Path, file_okay=False), metavar=metavar, **more)


_HOME_HELP = "The lab's folder (LABOS_HOME; ./lab if neither is given)."
home_option = click.option("--home", metavar="DIR", help=_HOME_HELP)
folder_home_option = click.option("--home", metavar="DIR", help=_HOME_HELP, callback=expect_folder)
database_option = click.option(
    "--database",
    metavar="URL",
    help="sqlite:///file or postgresql://… (LABOS_DATABASE_URL; a file in the home folder).",
    callback=refuse_password,
)
ENDED_SHOWN = 20
"""The number of ended entries in a list, unless all are requested."""
all_option = click.option(
    "--all", "everything", is_flag=True, help=f"Show all that have ended, not only the last {ENDED_SHOWN}."
)
address_option = click.option(
    "--address",
    multiple=True,
    metavar="HOST",
    help="A further name or address by which other computers reach the secure bus.",
)
pki_option = folder_option(
    "--pki", help="The certificate authority (LABOS_PKI; pki in the lab's folder if neither is given)."
)
cert_option = folder_option(
    "--cert",
    help="The folder from `labos pki issue`, for a secure bus (default: the one in the lab's folder).",
)


def why_option(about: str = "The reason, for the log.", *, required: bool = False) -> Callable[[F], F]:
    """``--why TEXT``: the user's reason for the command, stored in the log."""
    default = None if required else ""
    return click.option("--why", metavar="TEXT", required=required, default=default, help=about)


def wait_option(about: str, *, default: bool) -> Callable[[F], F]:
    """``--wait/--no-wait``: whether the command waits for the end of what it began."""
    return click.option("--wait/--no-wait", default=default, show_default=True, help=about)


def json_option_saying(about: str) -> Callable[[F], F]:
    """``--json`` with a help text of its own. Errors are also written as JSON then."""
    return click.option("--json", "as_json", is_flag=True, help=about, expose_value=False, callback=note_json)


json_option = json_option_saying("JSON, for programs.")
quiet_option = click.option("--quiet", is_flag=True, help="Print only the end.")
simulate_option = click.option(
    "--simulate", is_flag=True, help="Use simulated instruments. A running lab must be simulated."
)
priority_option = click.option(
    "--priority", type=int, default=0, show_default=True, help="Runs with a higher priority go first."
)
propose_option = click.option(
    "--propose",
    is_flag=True,
    help="Let it wait for an operator's approval, even if the policy does not require one.",
)
user_option = click.option(
    "--user",
    envvar="LABOS_USER",
    metavar="NAME",
    callback=lambda context, option, name: find_user(name),
    help="The requesting user (LABOS_USER; your login if not given).",
)


class Asker(msgspec.Struct, frozen=True):
    """The lab and the user: the given options ``--user`` and ``--home``."""

    user: str
    home: str | None

    def lab(self) -> LabClient:
        """The lab to use. Raises NotFound if none runs."""
        from labos.cli._lab import need_lab

        return need_lab(self.home)


def lab_and_json(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--home`` and ``--json``; the command gets ``asker: Asker`` without a given user."""

    @wraps(command)
    def wrap(*args: Any, home: str | None, **options: Any) -> Any:
        return command(*args, asker=Asker(find_user(None), home), **options)

    return home_option(json_option(wrap))


def asker_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--user``, ``--home`` and ``--json``; the command gets ``asker: Asker``."""

    @wraps(command)
    def wrap(*args: Any, user: str, home: str | None, **options: Any) -> Any:
        return command(*args, asker=Asker(user, home), **options)

    return user_option(home_option(json_option(wrap)))


lab_options = options_together(
    home_option,
    database_option,
    speed_option,
    click.option(
        "--seed", type=int, default=0, help="The seed of the simulated instruments' random durations."
    ),
)
"""Options of commands that may run a kernel themselves."""


def web_options(about: str) -> Callable[[F], F]:
    """Options of commands that serve HTTP: TLS, a proxy, and the names of the server (``about``). The
    parameters have the names of the settings."""
    return options_together(
        click.option(
            "--tls-cert",
            "tls_certificate",
            type=click.Path(dir_okay=False),
            default="",
            help="HTTP over TLS: a PEM file with the certificate and those of its issuers.",
        ),
        click.option(
            "--tls-key",
            type=click.Path(dir_okay=False),
            default="",
            help="The private key of --tls-cert, a PEM file.",
        ),
        click.option(
            "--behind-proxy",
            is_flag=True,
            help=f"A proxy provides TLS for {about} and sends X-Forwarded-For. "
            "Only the proxy may reach the HTTP port.",
        ),
        click.option(
            "--name",
            "names",
            multiple=True,
            metavar="HOST",
            help=f"A name under which browsers reach {about}, such as lab.example.org; may be given "
            "several times.",
        ),
    )


def find_user(user: str | None) -> str:
    """The user's name: the given one, else the login name."""
    if user:
        return user
    import getpass

    try:
        login = getpass.getuser()
        return "labos-login" if login == "labos" else login  # that name is reserved for LabOS
    except (OSError, KeyError, ImportError):
        return "somebody"


def read_result(text: str | None) -> Any:
    """The value of ``--result``. Raises BadParameter."""
    if text is None:
        return None
    try:
        return json.loads(text)
    except ValueError as error:
        raise click.BadParameter(f"{text!r} is not JSON ({error}).", param_hint="--result") from error
