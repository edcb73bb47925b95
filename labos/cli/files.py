"""``labos files``: images, traces and raw data that steps have returned."""

from __future__ import annotations

from pathlib import Path, PurePath, PureWindowsPath

import click

from labos.cli._complete import make_completer
from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, show_lines, show_table
from labos.cli._query import Where, log_at_and_json, now_ns, open_contents, open_database
from labos.core.texts import CONTROL
from labos.errors import BadInput, NotFound
from labos.ports import BlobReader
from labos.services.doctor import note_retention
from labos.services.files import ResultFile, list_files
from labos.services.history import find_position_at
from labos.services.times import Moment, show_time
from labos.services.verification import find_unused_blobs
from labos.store import FolderBlobs, open_blobs

COLUMNS = ("run", "step", "file", "bytes", "time", "sha256")
SHORT = 12
"""The number of digits of a SHA-256 that identify a file here."""


@click.command("files", short_help="List or fetch files that steps have returned.")
@click.argument("run", shell_complete=make_completer("run"), required=False, default="")
@click.argument("file", required=False, default="", metavar="[FILE]")
@click.option(
    "-o",
    "--output",
    "to",
    metavar="PATH",
    help="Fetch to this folder; with FILE, to this file (- for stdout).",
)
@click.option(
    "--unused", is_flag=True, help="List files to which nothing in the log refers, instead of files of runs."
)
@click.option("--remove", is_flag=True, help="With --unused: remove files that are older than --keep-days.")
@click.option(
    "--keep-days",
    type=click.FloatRange(min=1),
    default=7.0,
    show_default=True,
    help="With --remove: the age of files to remove.",
)
@log_at_and_json
def command(
    where: Where,
    run: str,
    file: str,
    to: str | None,
    unused: bool,
    remove: bool,
    keep_days: float,
    moment: Moment,
) -> None:
    """List or fetch files that steps have returned: pictures, traces, raw data.

    FILE is a file's name, or the beginning of its SHA-256. Each fetched file is checked by its SHA-256.
    Existing files are not overwritten.

    \b
    labos files                        list the files of all runs
    labos files R3                     list the files of one run
    labos files R3 -o pictures         fetch all files of a run into a folder
    labos files R3 plate.png -o .      fetch one file
    labos files --unused --remove      remove files of refused requests or of a killed kernel
    """
    if remove and not unused:
        raise click.UsageError("--remove needs --unused.")
    if unused:
        if run or to is not None:
            raise click.UsageError("--unused cannot be combined with RUN, FILE and --output.")
        _show_unused(where, keep_days if remove else None)
        return
    with open_current_log(where, moment, last_known=False) as store:
        found = list_files(store, run, find_position_at(store, moment))
    if file:
        found = _find_files(found, run, file)
    if to is not None:
        if not run:
            raise click.UsageError("Name the run with the files to fetch.")
        with open_contents(where) as blobs:
            written = _fetch(blobs, found, to, one=bool(file))
        end_with_json({"written": written})
        show_lines(written if to != "-" else (), "wrote ")
        return
    end_with_json(found)
    if found:
        show_table(COLUMNS, [_row(result_file) for result_file in found])
        if file:
            click.echo(f"To fetch it: labos files {run} {file} -o .")
    else:
        click.echo(f"{run or 'This lab'} has no files.")


def _show_unused(where: Where, keep_days: float | None) -> None:
    """List the files that no event names; with ``keep_days``, remove those that are older."""
    if where.lab:
        raise BadInput(
            "Unused files can be listed only on the lab's computer, in the lab's folder.",
            remedy="Use --home there.",
        )
    blobs = open_blobs(where.settings.blobs)
    if keep_days is not None and not isinstance(blobs, FolderBlobs):
        raise BadInput(
            "LabOS does not remove files in an object store.",
            remedy="List the unused files, and remove them there while no kernel runs.",
        )
    removed: list[str] = []
    if isinstance(blobs, FolderBlobs) and keep_days is not None:
        blobs.put_back_removed()
    with open_database(where) as store:
        found = find_unused_blobs(store, blobs)
    if isinstance(blobs, FolderBlobs) and keep_days is not None:
        before = now_ns() / 1e9 - keep_days * 86_400
        removed = [name for name in found if blobs.remove_unused(name, before)]
        note_retention(where.home, "removed_at", now_ns())
    end_with_json({"unused": found, "removed": removed})
    for name in found:
        click.echo(f"{name}{' removed' if name in removed else ''}")
    message = f"{len(found)} files without a reference in the log"
    click.echo(f"{message}; {len(removed)} were removed." if keep_days is not None else f"{message}.")


def _row(result_file: ResultFile) -> tuple[str, ...]:
    return (
        result_file.run,
        result_file.step,
        result_file.file,
        str(result_file.bytes),
        show_time(result_file.time),
        result_file.sha256[:SHORT],
    )


def _find_files(found: list[ResultFile], run: str, file: str) -> list[ResultFile]:
    """The files of that name, with or without their folder, or the one of that SHA-256. Raises NotFound."""
    wanted = [result_file for result_file in found if result_file.file == file]
    wanted = wanted or [result_file for result_file in found if PurePath(result_file.file).name == file]
    if not wanted and len(file) >= 4:
        wanted = [result_file for result_file in found if result_file.sha256.startswith(file.lower())]
    if not wanted:
        raise NotFound(f"{run} has no file {file!r}.", remedy=f"List them: labos files {run}")
    return wanted


def _name_of(result_file: ResultFile) -> str:
    """The name of a file here: nodes choose names, and a name must not lead out of the folder."""
    name = PureWindowsPath(Path(result_file.file).name).name
    fits = name not in ("", ".", "..") and not CONTROL.search(name)
    return name if fits else f"file-{result_file.sha256[:SHORT]}"


def _fetch(blobs: BlobReader, found: list[ResultFile], to: str, *, one: bool) -> list[str]:
    """Write files; returns where. Raises BadInput if a file exists already, NotFound, LogDamaged."""
    if to == "-":
        for result_file in found[-1:]:
            click.echo(blobs.get(result_file.sha256), nl=False)
        return []
    folder = Path(to)
    into_folder = not one or folder.is_dir() or to.endswith(("/", "\\"))
    targets: dict[Path, ResultFile] = {}
    for result_file in found:
        path = folder / _name_of(result_file) if into_folder else folder
        known = targets.get(path)
        if known is not None and known.sha256 != result_file.sha256:
            path = path.with_name(
                f"{result_file.step}-{result_file.sha256[:SHORT]}-{path.name}".replace("/", "_")
            )
        targets[path] = result_file
    for path, result_file in targets.items():
        if path.exists() and path.read_bytes() != blobs.get(result_file.sha256):
            raise BadInput(f"{path} already exists, and is another file.", remedy="Name another --output.")
    for path, result_file in targets.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(blobs.get(result_file.sha256))
    return [str(path) for path in targets]
