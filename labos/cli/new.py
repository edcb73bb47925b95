"""``labos new``: templates that work without changes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click

from labos.cli._options import json_option
from labos.cli._out import end_with_json, show_lines
from labos.cli.schema import write_schema
from labos.errors import BadInput

SKELETONS = Path(__file__).with_name("skeletons")
SCHEMAS = Path(".labos")
"""The folder of the schemas, beside the new file; the file's first line names it."""

NEXT = {
    "workcell": "labos validate {file}\nlabos up {file} --simulate",
    "workflow": "labos validate {file} --workcell rpl\nlabos run {file} --workcell rpl --simulate --speed 60",
    "app": "labos up rpl --simulate --speed 60\npython {file} --home lab",
}
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_ ()\-]*")


@click.command("new")
@click.argument("kind", type=click.Choice(["workcell", "workflow", "app"]))
@click.argument("name")
@click.option("--force", is_flag=True, help="Overwrite existing files.")
@json_option
def command(kind: str, name: str, force: bool) -> None:
    """Create a template of a workcell, a workflow or an application with this NAME.

    NAME may be a path. The files work without changes: the workflow runs on the new workcell, and also on
    the packaged workcell rpl. An application is a Python program with a workflow file beside it.

    \b
    labos new workcell bench
    labos new workflow seal
    labos validate seal.yaml --workcell bench.yaml
    labos run seal.yaml --workcell bench.yaml --simulate
    labos new app screening

    Editors use the schemas in the folder .labos beside the files to complete and check them.
    """
    path = Path(name)
    stem = path.name.removesuffix(".yaml").removesuffix(".yml").removesuffix(".py")
    if not _NAME.fullmatch(stem):
        raise BadInput(
            f"{stem!r} cannot be a name.",
            remedy="Use letters, digits, '_', '-' and spaces. Begin with a letter or digit.",
        )
    if kind == "app" and not stem.replace("-", "_").isidentifier():
        raise BadInput(f"{stem!r} cannot be a program's name.", remedy="Use letters, digits, '_' and '-'.")
    files = _make_files(kind, path.parent, stem)
    there = [str(file) for file in files if file.exists()]
    if there and not force:
        raise BadInput(f"There already is {', '.join(there)}.", remedy="Use another name, or add --force.")
    schemas = _make_schemas(kind, path.parent)
    for file, text in {**schemas, **files}.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        except OSError as error:
            raise BadInput(f"{file} cannot be written: {error.strerror or error}.") from None
    end_with_json({"written": [str(file) for file in files]})
    show_lines(files, "wrote ")
    first = next(iter(files))
    click.echo("Next:")
    show_lines(NEXT[kind].format(file=shlex.quote(str(first))).splitlines(), "  ")


def _make_files(kind: str, folder: Path, name: str) -> dict[Path, str]:
    """The files to write, the most important first."""
    if kind == "app":
        return {
            folder / f"{name}.py": _skeleton("app.py", name),
            folder / f"{name}.yaml": _make_modeline("workflow") + _skeleton("workflow.yaml", name),
        }
    return {folder / f"{name}.yaml": _make_modeline(kind) + _skeleton(f"{kind}.yaml", name)}


def _skeleton(file: str, name: str) -> str:
    return (SKELETONS / file).read_text(encoding="utf-8").replace("NAME", name)


def _make_modeline(kind: str) -> str:
    from labos.spec.schema import MODELINE

    return f"{MODELINE}{(SCHEMAS / f'{kind}.schema.json').as_posix()}\n"


def _make_schemas(kind: str, folder: Path) -> dict[Path, str]:
    kind = "workflow" if kind == "app" else kind
    return {folder / SCHEMAS / f"{kind}.schema.json": write_schema(kind)}
