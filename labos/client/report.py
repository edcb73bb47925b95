"""The start of an application from a shell, and its report at the end: plots, a table and one page in a
folder, and a line with the place of the data.

::

    def prepare(given):
        return lambda lab: [measure(lab, given.user, resume=given.resume)]

    parser = make_parser("Measure something.", user="ada", out="mine")
    sys.exit(run_program("my application", parser, prepare))

An application passes ``given.resume`` to its experiment, which continues where it was.
"""

from __future__ import annotations

import argparse
import base64
import csv
import html
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import yaml

from labos.client._experiment import Experiment
from labos.client._lab import LabClient
from labos.errors import BadInput, LabosError

PICTURE_DPI = 110
MEDIA = {".png": "image/png", ".jpg": "image/jpeg"}
STYLE = (
    "body{font-family:sans-serif;max-width:50em;margin:2em auto}img{max-width:100%}"
    "td,th{padding:.2em .6em;text-align:right}"
)


class Drawing(Protocol):
    """A figure that can be saved as an image, for example of Matplotlib."""

    def savefig(self, file: Any, **options: Any) -> Any: ...


class ReportPage(NamedTuple):
    """A page, and a line with the place of the data."""

    page: Path
    line: str


def write_report(
    experiment: Experiment,
    folder: Path,
    title: str,
    *,
    paragraphs: Sequence[str],
    pictures: Mapping[str, tuple[str, Drawing | bytes]],
    table: Sequence[Mapping[str, Any]] = (),
    files: str = "its files",
) -> ReportPage:
    """Write the images (by file name: a caption, and a figure or a file's content), the table as
    ``data.csv``, and ``index.html``, which contains all of it and needs no other file. The report is logged
    as a publication with the names of the files. ``files`` is the text for the files in the log."""
    folder.mkdir(parents=True, exist_ok=True)
    contents = {name: _read_content(drawing, Path(name).suffix) for name, (_, drawing) in pictures.items()}
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    written = [folder / name for name in contents]
    if table:
        written.append(_write_table(folder / "data.csv", table))
    page = folder / "index.html"
    where = f"experiment {experiment.id} in the lab's log, with {files} as files"
    shown = [(name, pictures[name][0], content) for name, content in contents.items()]
    page.write_text(_write_page(f"{title} {experiment.id}", paragraphs, shown, table, where), "utf-8")
    experiment.note("publication", "report", files=[str(path.resolve()) for path in (*written, page)])
    return ReportPage(page, f"The data: {where}; {page}")


def make_parser(description: str, *, user: str, out: str) -> argparse.ArgumentParser:
    """The options of every application; ``out`` is the default folder for its report."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--home", help="the lab's folder")
    parser.add_argument("--url", default="", help="the lab's address, instead of its folder")
    parser.add_argument("--user", default=user, help=f"the user of the experiment ({user})")
    parser.add_argument(
        "--resume",
        default="",
        metavar="E3",
        help="continue where the program was killed: the experiment (labos experiments)",
    )
    parser.add_argument("--out", type=Path, help=f"a folder for the report ({out})")
    parser.add_argument(
        "--patience", type=float, default=30.0, help="the longest time without an answer of the lab (s)"
    )
    return parser


def read_payload(path: Path, kind: type, needs: Mapping[str, str] = {}) -> dict[str, Any]:
    """The values in a payload file (YAML) for the fields of a dataclass. ``needs`` are required fields, each
    with a text that says what to write. Raises BadInput."""
    try:
        given = yaml.safe_load(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadInput(f"{path} cannot be read: {error}") from None
    names = sorted(field.name for field in fields(kind))
    known = f"Known are {', '.join(names)}."
    for name, remedy in needs.items():
        if not isinstance(given, dict) or name not in given:
            raise BadInput(f"{path} names no `{name}`.", remedy=remedy)
    if not isinstance(given, dict):
        raise BadInput(f"{path} is not a table.", remedy=known)
    if unknown := sorted(str(name) for name in given if name not in names):
        raise BadInput(f"{path}: {unknown[0]!r} is unknown.", remedy=known)
    return given


def run_program(
    name: str,
    parser: argparse.ArgumentParser,
    prepare: Callable[[argparse.Namespace], Callable[[LabClient], Sequence[str]]],
) -> int:
    """Start an application; returns its exit code. ``prepare`` reads the arguments before the first request
    to a lab. It returns a function that does the work and returns the report, line by line. An error is one
    line, and a second one if the program can continue with ``--resume``."""
    given = parser.parse_args()
    try:
        work = prepare(given)
        with LabClient(given.url, home=given.home, patience_s=given.patience) as lab:
            lines = work(lab)
    except (LabosError, KeyboardInterrupt) as error:
        is_wrong = isinstance(error, LabosError)
        messages = [str(error)] if is_wrong else []
        sys.stderr.writelines(f"{name}: {line}\n" for line in (*messages, *getattr(error, "__notes__", ())))
        return 1 if is_wrong else 130
    for line in lines:
        sys.stdout.write(f"{name}: {line}\n")
    return 0


def _read_content(drawing: Drawing | bytes, suffix: str) -> bytes:
    if isinstance(drawing, bytes):
        return drawing
    file = io.BytesIO()
    drawing.savefig(file, format=suffix.lstrip("."), dpi=PICTURE_DPI)
    return file.getvalue()


def _write_table(path: Path, table: Sequence[Mapping[str, Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return path


def _write_page(
    title: str,
    paragraphs: Sequence[str],
    pictures: Sequence[tuple[str, str, bytes]],
    table: Sequence[Mapping[str, Any]],
    where: str,
) -> str:
    body = [f"<p>{html.escape(paragraph)}</p>" for paragraph in paragraphs]
    for name, shows, content in pictures:
        data = base64.b64encode(content).decode()
        kind = MEDIA[Path(name).suffix]
        body.append(
            f'<img alt="{html.escape(shows)}" title="{html.escape(name)}" src="data:{kind};base64,{data}">'
        )
    if table:
        head = "".join(f"<th>{html.escape(str(name))}</th>" for name in table[0])
        rows = ("".join(f"<td>{html.escape(_show(value))}</td>" for value in row.values()) for row in table)
        body.append(f"<table><tr>{head}</tr>" + "".join(f"<tr>{row}</tr>\n" for row in rows) + "</table>")
        body.append('<p>The numbers: <a href="data.csv">data.csv</a>.</p>')
    body.append(f"<p>The data: {html.escape(where)}.</p>")
    name = html.escape(title)
    return (
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{name}</title>\n'
        f"<style>{STYLE}</style>\n"
        f"<h1>{name}</h1>\n" + "\n".join(body) + "\n</html>\n"
    )


def _show(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
