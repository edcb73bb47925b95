"""``labos import``: converts files of other labs to the form of LabOS."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from labos.cli._options import json_option
from labos.cli._out import end_with_json, show_table
from labos.errors import BadInput, NotFound, SpecError
from labos.spec import Finding, SpecErrors
from labos.spec.dialects import find_kind, make_unknown_error
from labos.spec.findings import ASSUMED, list_findings, make_finding
from labos.spec.library import SUFFIXES
from labos.spec.references import iterate_texts
from labos.spec.source import read
from labos.spec.uses import read_uses, sort_workflows_by_workcell

if TYPE_CHECKING:
    from labos.core.model import Description
    from labos.spec.source import Source


LONGEST_PATH = 255

MOST_TOLD = 20
"""At most so many assumptions are listed at the end."""


class WrittenFile(msgspec.Struct):
    """A file that was converted. ``kind`` is workcell, workflow or labware; ``assumed`` are the missing facts
    that were assumed, and the parts that LabOS does not use."""

    source: str
    target: str
    kind: str
    dialect: str
    name: str
    counts: dict[str, int]
    assumed: list[Finding]
    text: str = ""


class LeftFile(msgspec.Struct):
    """A file that was not converted, and why."""

    source: str
    why: list[Finding]


class CopiedFile(msgspec.Struct):
    """A file that an argument names, copied to the same place beside its workflow."""

    source: str
    target: str


class ImportOutcome(msgspec.Struct):
    """``skipped`` files are of another kind; ``refused`` files cannot be converted as they are."""

    written: list[WrittenFile] = []
    copied: list[CopiedFile] = []
    skipped: list[LeftFile] = []
    refused: list[LeftFile] = []


@click.command("import")
@click.argument("path", metavar="FILE|FOLDER")
@click.option(
    "-o", "--output", default="imported", show_default=True, metavar="DIR", help="The folder to write to."
)
@click.option("--force", is_flag=True, help="Overwrite existing files.")
@json_option
def command(path: str, output: str, force: bool) -> None:
    """Convert workcells and workflows of WEI and MADSci, and labware of Opentrons, to LabOS' own format.

    The command searches a FOLDER for YAML files and keeps its structure. If a workcell file lacks
    information, the command drafts it from the folder's workflows that use this workcell: actions of a
    module without a driver, actions and arguments that a driver does not know, and places. So you can
    simulate the result at once. Comments are kept. Each assumption is written as a comment at its place,
    and is listed at the end, the most important first. Files in LabOS' format, and files of the FOLDER
    that arguments name, are copied. Other files are skipped. Exit code 1 if a file is refused.

    \b
    labos import rpl_workcell.yaml -o specs
    labos import ~/wei_lab -o specs --force
    labos import corning_96_wellplate_360ul_flat.json -o specs/labware
    labos validate specs/workflows/pcr.yaml --workcell specs/rpl_workcell.yaml

    LabOS can also run such files without conversion.
    """
    from labos.bootstrap import descriptions

    outcome = read_all(Path(path), Path(output), descriptions())
    _write(outcome, force=force)
    end_with_json(_show(outcome), int(bool(outcome.refused)))
    _show_outcome(outcome)
    if outcome.refused:
        raise click.exceptions.Exit(1)


def read_all(path: Path, output: Path, descriptions: Mapping[str, Description]) -> ImportOutcome:
    """Read everything before anything is written. Raises NotFound."""
    from labos.spec.importing import Imported, Moved, import_spec

    outcome = ImportOutcome()
    taken: set[Path] = set()
    inside = path.resolve() in output.resolve().parents
    sources: list[tuple[Path, Path, Source]] = []
    for file, under in _iterate_files(path):
        if inside and file.resolve().is_relative_to(output.resolve()):
            continue  # written by an earlier import
        try:
            source = read(file, last_wins=True)
            if find_kind(source) is None and path.is_dir():
                outcome.skipped.append(LeftFile(str(file), [make_finding(make_unknown_error(source))]))
                continue
            sources.append((file, under, source))
        except SpecError as error:
            outcome.refused.append(LeftFile(str(file), [make_finding(error)]))
    users = sort_workflows_by_workcell([source for _, _, source in sources])
    moved: dict[str, list[Moved]] = {}
    files: dict[str, Imported] = {}
    for file, _, source in sorted(sources, key=lambda each: each[2].file not in users):  # workcells first
        try:
            uses = read_uses(users.get(source.file, ()))
            found = import_spec(source, descriptions, uses, moved.get(source.file, ()))
        except (SpecError, SpecErrors) as error:
            faults = [finding for finding in list_findings(error) if finding.severity == "error"]
            outcome.refused.append(LeftFile(str(file), faults))
            continue
        files[source.file] = found
        if found.moved is not None:
            for workflow in users.get(source.file, ()):
                moved.setdefault(workflow.file, []).append(found.moved)
    for file, under, source in sources:
        if source.file not in files:
            continue
        found = files[source.file]
        target = _choose_free_name(output / under, taken)
        text = found.text or file.read_text("utf-8-sig")
        outcome.written.append(
            WrittenFile(
                str(file), str(target), found.kind, found.dialect, found.name, found.counts,
                list(found.findings), text,
            )
        )  # fmt: skip
        if found.kind == "workflow" and path.is_dir():
            outcome.copied += _find_named_files(source, path.resolve(), output)
    read_too = {Path(file.source).resolve() for file in outcome.written}
    read_too |= {Path(left.source).resolve() for left in outcome.refused}
    copies = {file.target: file for file in outcome.copied if Path(file.source) not in read_too}
    outcome.copied = list(copies.values())
    return outcome


def _find_named_files(workflow: Source, root: Path, output: Path) -> Iterator[CopiedFile]:
    """The files of the folder that a workflow names in its arguments."""
    here = Path(workflow.file).resolve().parent
    for text in sorted(set(iterate_texts(workflow.data))):
        if "\n" in text or len(text) > LONGEST_PATH:
            continue
        with contextlib.suppress(OSError, ValueError):
            file = (here / text).resolve()
            if file.is_file() and file.is_relative_to(root):
                yield CopiedFile(str(file), str(output / file.relative_to(root)))


def _iterate_files(path: Path) -> Iterator[tuple[Path, Path]]:
    """Each YAML file and its path below the folder. Raises NotFound."""
    if path.is_file():
        yield path, Path(path.name)
    elif path.is_dir():
        for file in sorted(path.rglob("*")):
            under = file.relative_to(path)
            if file.suffix in SUFFIXES and file.is_file() and not any(p.startswith(".") for p in under.parts):
                yield file, under
    else:
        raise NotFound(f"There is no file or folder {str(path)!r}.", remedy="Check its path.")


def _choose_free_name(target: Path, taken: set[Path]) -> Path:
    """A unique name for each file, also if two differ only in ``.yaml`` and ``.yml``."""
    number, found = 1, target.with_suffix(".yaml")
    while found in taken:
        number += 1
        found = target.with_name(f"{target.stem}-{number}.yaml")
    taken.add(found)
    return found


def _write(outcome: ImportOutcome, *, force: bool) -> None:
    """Raises BadInput, before anything is written, for files that exist already."""
    targets = [file.target for file in outcome.written] + [file.target for file in outcome.copied]
    there = [target for target in targets if Path(target).exists()]
    if there and not force:
        more = f" and {len(there) - 3} more" if len(there) > 3 else ""
        raise BadInput(
            f"The output already has {', '.join(there[:3])}{more}.",
            remedy="Name another --output, or add --force.",
        )
    contents = {file.target: file.text.encode() for file in outcome.written}
    contents |= {file.target: Path(file.source).read_bytes() for file in outcome.copied}
    for name, content in contents.items():
        target = Path(name)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        except OSError as error:
            raise BadInput(f"{target} cannot be written: {error.strerror or error}.") from None


def _show(outcome: ImportOutcome) -> dict[str, Any]:
    shown: dict[str, Any] = msgspec.to_builtins(outcome)
    for file in shown["written"]:
        del file["text"]
    return shown


def _show_outcome(outcome: ImportOutcome) -> None:
    rows = [
        (file.target, f"{file.kind} ({file.dialect})", _describe_counts(file.counts), str(len(file.assumed)))
        for file in outcome.written
    ]
    if rows:
        show_table(("written", "kind", "holds", "assumed"), rows)
    for file in outcome.copied:
        click.echo(f"copied: {file.target}")
    for left in outcome.skipped:
        click.echo(f"skipped: {left.why[0].as_error()}")
    for left in outcome.refused:
        for finding in left.why:
            click.echo(f"refused: {finding.as_error()}")
    _show_assumptions(outcome)
    counts = (len(outcome.written), len(outcome.skipped), len(outcome.refused))
    click.echo("{} written, {} skipped, {} refused.".format(*counts))


def _show_assumptions(outcome: ImportOutcome) -> None:
    """The assumptions, the most important first; the others are comments in the files."""
    findings = sorted(
        (finding for file in outcome.written for finding in file.assumed if finding.assumed),
        key=lambda finding: ASSUMED.index(finding.assumed),
    )
    if not findings:
        return
    click.echo("Assumptions, the most important first:")
    for finding in findings[:MOST_TOLD]:
        click.echo(f"  {finding.as_error()}")
    if len(findings) > MOST_TOLD:
        click.echo(f"  … and {len(findings) - MOST_TOLD} more; each is a comment in its file.")


def _describe_counts(counts: dict[str, int]) -> str:
    return ", ".join(
        f"{count} {what.removesuffix('s') if count == 1 else what}" for what, count in counts.items() if count
    )
