"""``labos retarget``: rewrites a workflow of one workcell for another."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._lab import find_spec_path
from labos.cli._options import file_option, json_option
from labos.cli._out import end_with_json, show_lines, show_table
from labos.cli._payload import payload_option, read_payload
from labos.cli.validate import examine
from labos.errors import BadInput, SpecError
from labos.spec import compile_workcell
from labos.spec.retarget import compare_lines, propose, rename
from labos.spec.source import read
from labos.spec.uses import read_workflow


@click.command("retarget", short_help="Rewrite a workflow for another workcell.")
@click.argument("workflow", shell_complete=make_completer("workflow"))
@click.option(
    "--from", "old", required=True, metavar="W", help="The workcell for which the workflow was written."
)
@click.option("--to", "new", required=True, metavar="W", help="The workcell for the new workflow.")
@click.option(
    "--map", "maps", multiple=True, metavar="OLD=NEW", help="A module, and the module that replaces it."
)
@file_option("--output", "-o", help="The file to write (WORKFLOW_TO.yaml).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@payload_option
@json_option
def command(
    workflow: str,
    old: str,
    new: str,
    maps: tuple[str, ...],
    output: Path | None,
    force: bool,
    payloads: tuple[str, ...],
) -> None:
    """Rewrite WORKFLOW for another workcell. For each module, the command proposes a module of the other
    workcell with the same actions and stations, and reports what does not fit. It writes a file with the new
    names and validates it. Only names change. Exit code 1 if something does not fit, or if the file has
    errors.

    \b
    labos retarget seal.yaml --from rpl --to bio
    labos retarget seal.yaml --from rpl --to bio --map pf400=platecrane -o bio/seal.yaml
    labos retarget seal.yaml --from rpl --to bio --json

    Put differences other than names (an incubator's steps, lids) into a file for each workcell, in the
    folder of the written file, and refer to it with `use:`.
    """
    from labos.bootstrap import descriptions

    path, known = find_spec_path("workflows", workflow), descriptions()
    before, after = (
        compile_workcell(read(find_spec_path("workcells", name), last_wins=True), known).workcell
        for name in (old, new)
    )
    _, file = read_workflow(read(path, last_wins=True))
    if file is None:
        raise SpecError(f"{path} is not a readable workflow.", remedy="labos validate shows the errors.")
    target = output or path.with_name(f"{path.stem}_{after.name}.yaml")
    if target.exists() and not force:
        raise BadInput(f"{target} already exists.", remedy="Name another with --output, or add --force.")
    proposal = propose(file, before, after, _parse_pairs(maps), known)
    text = path.read_text(encoding="utf-8")
    renamed = rename(text, proposal.mapping, (old, new))
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(renamed, encoding="utf-8")
    verdict, _ = examine(str(target), new, read_payload(payloads), True)
    fits = verdict.sound and not proposal.misfits
    difference = list(compare_lines(text, renamed))
    facts = {"fits": fits, "file": str(target), "difference": difference, "findings": verdict.findings}
    end_with_json({**facts, **msgspec.to_builtins(proposal)}, int(not fits))
    show_table(("module", "becomes", "why"), [(m.module, m.becomes or "-", m.why) for m in proposal.matches])
    show_lines(proposal.misfits, "does not fit: ")
    show_lines(difference)
    for finding in verdict.findings:
        click.echo(f"{finding.severity}: {finding.as_error()}")
    click.echo(f"{target}: written, " + ("no errors." if fits else "it cannot be used as it is."))
    if not fits:
        click.get_current_context().exit(1)


def _parse_pairs(maps: tuple[str, ...]) -> dict[str, str]:
    """Raises BadInput for a text that is not a pair of names."""
    found = {}
    for pair in maps:
        old, equals, new = pair.partition("=")
        if not (old and equals and new):
            raise BadInput(
                f"--map {pair!r} is not a pair of modules.", remedy="Write OLD=NEW: pf400=platecrane."
            )
        found[old] = new
    return found
