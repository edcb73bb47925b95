"""Code that the commands about users, groups, roles and signing in share."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from labos.core.lab import WHOLE_LAB
from labos.core.users import ROLES, group_subject, user_subject

if TYPE_CHECKING:
    from labos.client import LabClient

workcell_option = click.option(
    "--workcell", metavar="NAME", help="Only in this workcell; the whole lab if not given."
)
role_choice = click.Choice(ROLES)


@contextmanager
def lab_or_its_folder(home: str | None) -> Iterator[LabClient]:
    """The running lab. If it does not run, it is opened for as long as the block lasts, without nodes, so
    that its first user can be added before other computers reach it. Raises NotFound for a lab that never
    ran."""
    from labos.cli._lab import find_lab, need_lab
    from labos.settings import Settings, keep_private, last_kernel

    settings = Settings.make(home)
    running = find_lab(home)
    if running is not None or last_kernel(settings.home) is None:
        with need_lab(home) if running is None else running as client:
            yield client
        return
    from labos.bootstrap import LabThread
    from labos.client import LabClient

    keep_private()
    with LabThread(settings, nodes="none"), LabClient(home=settings.home) as client:
        yield client


def scope_of(workcell: str | None) -> str:
    return workcell or WHOLE_LAB


def subject_of(name: str) -> str:
    """``group:NAME`` is a group; a name without it is a user."""
    return name if name.startswith((user_subject(""), group_subject(""))) else user_subject(name)


def describe_roles(roles: Mapping[str, str]) -> str:
    """``operator in rpl, submitter``: a role without a workcell is valid in the whole lab."""
    return ", ".join(role if scope == WHOLE_LAB else f"{role} in {scope}" for scope, role in roles.items())


def ask_password(words: str, *, twice: bool = False) -> str:
    """A password, typed without an echo on a terminal, else the first line of standard input. It is never an
    option: all users of this computer can read the arguments of a command."""
    if sys.stdin.isatty():
        return str(click.prompt(words, hide_input=True, confirmation_prompt=twice))
    return sys.stdin.readline().rstrip("\r\n")
