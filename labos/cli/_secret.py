"""Passwords that people type, or that programs write to standard input."""

from __future__ import annotations

import sys

import click


def ask_password(words: str, *, twice: bool = False) -> str:
    """A password, typed without an echo on a terminal, else the first line of standard input. It is never an
    option: all users of this computer can read the arguments of a command."""
    if sys.stdin.isatty():
        return str(click.prompt(words, hide_input=True, confirmation_prompt=twice))
    return sys.stdin.readline().rstrip("\r\n")
