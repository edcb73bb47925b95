"""``labos schema``: the schemas of files, for editors."""

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
    click.echo(write_schema(kind), nl=False)


def write_schema(kind: str) -> str:
    """The schema in its published form."""
    from labos.spec.schema import make_schema

    return json.dumps(make_schema(kind), indent=2, ensure_ascii=False) + "\n"
