"""``labos policy``: which submissions wait for an approval."""

from __future__ import annotations

import click

from labos.cli._options import Asker, asker_options
from labos.cli._out import end_with_json, show_table
from labos.cli.approvals import policy_lines
from labos.cli.shares import read_file


@click.command("policy", short_help="Show or set which submissions need an approval.")
@click.option("--apply", "file", metavar="FILE", help="Set the policy from this file.")
@asker_options
def command(file: str | None, asker: Asker) -> None:
    """Show or set the policy: which submissions need an operator's approval, who may approve, the highest
    allowed priority, and what users without the role operator may book.

    Without a policy, only submissions of programs need an approval.

    \b
    labos policy                        the policy in force
    labos policy --apply policy.yaml    set the policy from a file
    labos approvals                     requests that wait
    """
    with asker.lab() as client:
        if file is not None:
            client.apply_policy(read_file(file), file, asker.user)
        answer = client.policy()
    end_with_json(answer)
    if not answer["applied"]:
        click.echo("No policy was set. These are the defaults.")
    show_table(("what", "says"), list(policy_lines(answer["policy"])))
