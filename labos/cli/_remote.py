"""Which commands work with a lab on another computer (LABOS_URL), and which need its folder."""

from __future__ import annotations

import os
from typing import TypeVar

import click
from click.core import ParameterSource

from labos.errors import BadInput
from labos.settings import HOME, URL, lab_url

P = TypeVar("P")


def is_given(name: str) -> bool:
    """Whether an option of the present command was given in the command line."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def expect_folder(context: click.Context, option: click.Parameter, home: P) -> P:
    """Callback of ``--home`` of commands that start a lab or a node, or that work on files of a lab; all
    others ask the lab that LABOS_URL names. Raises BadInput if only that address of the lab is known."""
    if not is_given(option.name or "") and not os.environ.get(HOME) and lab_url():
        raise BadInput(
            f"`{context.command_path}` needs the folder of the lab, and {URL} names a lab by its address.",
            remedy="Name the folder with --home, on the computer where it is.",
        )
    return home


def expect_folder_or_database(context: click.Context, option: click.Parameter, home: P) -> P:
    """As ``expect_folder``, for commands that also work with only a ``--database``."""
    return home if is_given("database") else expect_folder(context, option, home)


def lab_of(home: str | None) -> str:
    """The address of a lab on another computer; empty if the lab has a folder here. A
    --home goes before LABOS_URL, and that before LABOS_HOME.
    """
    return "" if home else lab_url()
