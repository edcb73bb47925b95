"""``labos policy``: which submissions wait for an approval."""

from __future__ import annotations

import click

from labos.cli._options import find_user, home_option, json_option, user_option
from labos.cli._out import show_json, show_table
from labos.cli.approvals import policy_lines
from labos.cli.shares import read_file


@click.command("policy", short_help="Which submissions wait for an approval.")
@click.option("--apply", "file", metavar="FILE", help="The policy from now on, as this file says.")
@user_option
@home_option
@json_option
def command(file: str | None, user: str | None, home: str | None, as_json: bool) -> None:
    """Which submissions wait for an operator's approval, who approves, how high a priority may be, and what
    whoever is no operator may book.

    Without a policy of its own, a lab lets what programs submit wait, and nothing else.

    \b
    labos policy                        what holds now
    labos policy --apply policy.yaml    from now on, as the file says
    labos approvals                     what waits
    """
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        if file is not None:
            client.apply_policy(read_file(file), file, find_user(user))
        told = client.policy()
    if as_json:
        show_json(told)
        return
    if not told["applied"]:
        click.echo("Nobody has applied a policy; this is what holds without one.")
    show_table(("what", "says"), list(policy_lines(told["policy"])))
