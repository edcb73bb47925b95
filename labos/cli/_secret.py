"""Passwords that people type, or that programs give on standard input."""

from __future__ import annotations

import sys

import click


def ask_password(words: str, *, twice: bool = False) -> str:
    """A password, typed unseen on a terminal, else the first line of standard input. It is never an option:
    everybody on this computer can read what a command was started with."""
    if sys.stdin.isatty():
        return str(click.prompt(words, hide_input=True, confirmation_prompt=twice))
    return sys.stdin.readline().rstrip("\r\n")
