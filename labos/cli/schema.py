"""``labos schema``: what may stand in a file, for editors."""

from __future__ import annotations

import json

import click

KINDS = ("workcell", "workflow", "labware", "description", "campaign", "shares", "policy")


@click.command("schema")
@click.argument("kind", type=click.Choice(KINDS))
def command(kind: str) -> None:
    """Print the JSON Schema of a KIND of file: each key, what it means, and what it takes.

    Editors with a YAML language server complete and check a file if its first line names its schema.
    `labos new` writes such a line.

    \b
    labos schema workflow > workflow.schema.json
    # yaml-language-server: $schema=workflow.schema.json

    The schema describes the file format. `labos validate` also checks the file against your bench.
    """
    click.echo(schema_text(kind), nl=False)


def schema_text(kind: str) -> str:
    """The schema as it is published."""
    from labos.spec.schema import schema_of

    return json.dumps(schema_of(kind), indent=2, ensure_ascii=False) + "\n"
