"""Code that all reading commands share: finds the log and opens it for reading."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec

from labos.cli._options import json_option as json_option
from labos.cli._options import refuse_password
from labos.cli._remote import expect_folder_or_database, is_given
from labos.client import LabClient, LabFiles, LabLog
from labos.clock import SystemClock
from labos.errors import LabosError
from labos.ports import BlobReader
from labos.services.log import Log
from labos.services.shown import ShownLog
from labos.services.times import Moment, parse_moment, parse_time
from labos.settings import Settings, lab_url, last_kernel
from labos.store import SqlEventStore, open_blobs, open_store

F = TypeVar("F", bound=Callable[..., Any])


class Where(msgspec.Struct, frozen=True):
    """The lab's home folder and, if it was given, its database; or the address of a ``lab`` on another
    computer."""

    home: Path
    database: str = ""
    lab: str = ""

    @property
    def url(self) -> str:
        """The database's URL: the given one, else the last kernel's, else the file in the home folder; for a
        lab on another computer, its address."""
        if self.lab or self.database:
            return self.lab or self.database
        last = last_kernel(self.home)
        return (last.database if last is not None else "") or name_own_database(self.home)

    @property
    def settings(self) -> Settings:
        """The settings of the lab."""
        return Settings.make(self.home, self.url)


def name_own_database(home: Path) -> str:
    return f"sqlite:///{home / 'labos.db'}"


def log_options(command: F, *, needs_folder: bool = False) -> F:
    """``--home`` and ``--database``; the command gets ``where: Where``, with the lab that LABOS_URL names
    unless it ``needs_folder``."""

    @wraps(command)
    def wrap(*args: Any, home: Path, database: str | None, **options: Any) -> Any:
        here = needs_folder or is_given("home") or is_given("database")
        lab = "" if here else lab_url()
        return command(*args, where=Where(home, database or "", lab), **options)

    wrapped = click.option(
        "--database",
        envvar="LABOS_DATABASE_URL",
        metavar="URL",
        help="The lab's database [default: that of the lab's kernel, else labos.db in its home].",
        callback=refuse_password,
        is_eager=True,  # before --home, which may then be left out
    )(wrap)
    return click.option(  # type: ignore[return-value]
        "--home",
        envvar="LABOS_HOME",
        type=click.Path(path_type=Path, file_okay=False),
        default=Path("lab"),
        show_default=True,
        help="The lab's folder.",
        callback=expect_folder_or_database if needs_folder else None,
    )(wrapped)


def log_and_json(command: F) -> F:
    """``--json``, ``--home`` and ``--database``; the command gets ``where: Where``."""
    return json_option(log_options(command))


def folder_options(command: F) -> F:
    """As ``log_options``, for a command that works on files of a lab."""
    return log_options(command, needs_folder=True)


def folder_and_json(command: F) -> F:
    """``folder_options`` with ``--json``."""
    return json_option(folder_options(command))


@contextmanager
def open_log(where: Where, *, stored: bool = False) -> Iterator[Log]:
    """The log, for reading only; works with and without a running kernel, and over HTTP. It is shown with the
    words beside it in place of references, or as it is ``stored``. Raises StoreUnavailable, LogTooNew,
    BadInput, LabUnreachable."""
    if where.lab:
        with LabClient(where.lab) as client:
            yield LabLog(client, stored=stored)
    else:
        with open_database(where) as store:
            yield store if stored else ShownLog(store)


@contextmanager
def open_contents(where: Where) -> Iterator[BlobReader]:
    """The files that results name, from the place where the lab stores them."""
    if where.lab:
        with LabClient(where.lab) as client:
            yield LabFiles(client)
    else:
        yield open_blobs(where.settings.blobs)


@contextmanager
def open_database(where: Where) -> Iterator[SqlEventStore]:
    """The log's database, opened for reading only. Raises StoreUnavailable, LogTooNew, BadInput."""
    with closing(open_store(where.url, create=False, read_only=True, home=where.home)) as store:
        yield store


def find_lab_id(where: Where) -> str:
    """The id of the lab; empty if it has no log yet."""
    try:
        with open_log(where) as log:
            return log.head().lab
    except LabosError:
        return ""


def now_ns() -> int:
    return SystemClock().now_ns()


def as_time(ctx: click.Context, param: click.Parameter, value: str | None) -> int | None:
    """Option callback: a time as people write it, as UTC nanoseconds. Raises BadInput."""
    return None if value is None else parse_time(value, now_ns())


def as_moment(ctx: click.Context, param: click.Parameter, value: str | None) -> Moment:
    """Option callback: a time or a position of the log. Raises BadInput."""
    return Moment() if value is None else parse_moment(value, now_ns())


AT_HELP = "A past moment: 2026-05-04T10:30, -2h, or a position of the log."


def at_option(command: F) -> F:
    return click.option("--at", "moment", metavar="TIME|POSITION", callback=as_moment, help=AT_HELP)(command)


def log_at_and_json(command: F) -> F:
    """``log_and_json`` with ``--at``; the command also gets the ``moment``."""
    return json_option(at_option(log_options(command)))
