"""Which commands work with a lab on another computer (LABOS_URL), and which need its folder."""

from __future__ import annotations

import os
from typing import TypeVar

import click
from click.core import ParameterSource

from labos.errors import BadInput
from labos.settings import HOME, URL, lab_url

P = TypeVar("P")

FOLDER = frozenset(
    {
        "labos up",
        "labos audit project",
        "labos audit reader",
        "labos audit rebuild",
        "labos audit status",
        "labos backup",
        "labos restore",
        "labos bundle",
        "labos checkpoint",
        "labos db restored",
        "labos db scrub",
        "labos db status",
        "labos db upgrade",
        "labos db url",
        "labos db writer",
        "labos diff",
        "labos doctor",
        "labos export crate",
        "labos key create",
        "labos key rotate",
        "labos key show",
        "labos node accept-unit",
        "labos node install",
        "labos node reset-epoch",
        "labos node start",
        "labos pki admit",
        "labos pki init",
        "labos pki issue",
        "labos pki list",
        "labos pki renew",
        "labos pki revoke",
        "labos bench show",
        "labos notifications",
        "labos notifications test",
        "labos notifications watch",
        "labos provenance",
        "labos sql",
        "labos take-over",
        "labos verify",
        "labos witness",
    }
)
"""Commands that start a lab or a node, or that work on files of a lab. All others that take a --home ask the
lab that LABOS_URL names; `labos demo` makes a lab of its own, and `labos bus` looks there for its
certificate only."""


def needs_folder() -> bool:
    """Whether the present command works on files of a lab."""
    return click.get_current_context().command_path in FOLDER


def is_given(name: str) -> bool:
    """Whether an option of the present command was given in the command line."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def folder_if_needed(context: click.Context, option: click.Parameter, home: P) -> P:
    """Callback of ``--home``. Raises BadInput for a command that needs the lab's folder if only the address
    of the lab is known."""
    named = context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE
    if context.command_path in FOLDER and not named and not os.environ.get(HOME) and lab_url():
        raise BadInput(
            f"`{context.command_path}` needs the folder of the lab, and {URL} names a lab by its address.",
            remedy="Name the folder with --home, on the computer where it is.",
        )
    return home


def folder_or_database(context: click.Context, option: click.Parameter, home: P) -> P:
    """As ``folder_if_needed``, for commands that also work with only a ``--database``."""
    named = context.get_parameter_source("database") is ParameterSource.COMMANDLINE
    return home if named else folder_if_needed(context, option, home)


def lab_of(home: str | None) -> str:
    """The address of a lab on another computer; empty if the lab has a folder here. A
    --home goes before LABOS_URL, and that before LABOS_HOME.
    """
    return "" if home else lab_url()
