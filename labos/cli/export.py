"""``labos export``: the content of the log, in formats of other programs."""

from __future__ import annotations

import os
import time
import zipfile
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

import click

from labos.audit._crate_experiment import Program
from labos.audit.cloudevents import encode_cloudevent
from labos.audit.crate import make_crate, runs_of
from labos.audit.kafka import SCHEME, KafkaSink, KafkaTopic, read_settings
from labos.audit.sinks import JsonLines
from labos.cli._audit import open_log_and_views
from labos.cli._complete import make_completer
from labos.cli._group import Suggesting
from labos.cli._options import file_option
from labos.cli._out import report_done
from labos.cli._query import (
    Where,
    as_moment,
    folder_and_json,
    log_options,
    now_ns,
    open_contents,
    open_log,
)
from labos.cli.bundle import make_bundle_of
from labos.errors import BadInput, SystemFailed
from labos.ports import LogQuery
from labos.private import create_file, make_folder
from labos.services.filters import check_types
from labos.services.history import find_position_at
from labos.services.log import Log
from labos.services.times import Moment

POLL_S = 0.25
BATCH = 1000
"""Events that are synced to disk together."""
CALM = 10
"""The priority below other processes (``nice``)."""
BROKER_S = 60.0
"""How long a broker may be away, unless the export follows the log."""


@click.group("export", cls=Suggesting, short_help="Export records in formats of other programs.")
def command() -> None:
    """Export the content of the log in formats of other programs.

    \b
    labos export crate R7 --to R7.zip    one run with its files, as an RO-Crate
    labos export crate E3 --to E3.zip    an experiment with all its runs
    labos export events                  the events, as CloudEvents

    For W3C PROV use `labos provenance --prov`, for CSV and Parquet `labos sql`.
    """


@command.command("crate")
@click.argument("name", metavar="RUN|EXPERIMENT", shell_complete=make_completer("run"))
@click.option(
    "--to",
    "target",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FOLDER|FILE.zip",
    help="The target: a new or empty folder, or a zip file.",
)
@click.option("--license", "license_", default="", metavar="URL", help="The licence of the crate.")
@click.option("--bundle", is_flag=True, help="Add the signed bundle of each run (`labos bundle`).")
@file_option("--program", help="The source file of the experiment's application, to add to the crate.")
@folder_and_json
def crate(where: Where, name: str, target: Path, license_: str, bundle: bool, program: Path | None) -> None:
    """Write a run, or the runs of an experiment, as an RO-Crate 1.1: workflow, payload, each step with its
    driver, times and user, labware, lots, results, and every file with its SHA-256.

    It conforms to Process Run Crate 0.5. If at least one step was carried out, it also conforms to
    Provenance Run Crate 0.5. The crate of an experiment also contains the application's work between the
    runs: decisions, computations with their results, publications with their files, and with --program its
    source. Users are named by their ids, as in the log. With --bundle, the recipient can check the events of
    the runs with the lab's public key.

    \b
    labos export crate R7 --to R7.zip
    labos checkpoint
    labos export crate E3 --to E3.zip --program color_picker.py
    labos export crate R7 --to R7 --bundle --license https://spdx.org/licenses/CC-BY-4.0
    """
    _check(target)
    source = _read_program(program) if program is not None else None
    with open_log_and_views(where) as (store, asker):
        made = make_crate(asker, store, name, now_ns(), license_, source)
        runs = [run.run for run in runs_of(asker, name)]
    for run in runs if bundle else ():
        data, _ = make_bundle_of(where, run)
        words = f"The events of {run} with their proof: labos verify --bundle {run}.zip"
        made.put(f"bundles/{run}.zip", data, name=words, encodingFormat="application/zip")
    with open_contents(where) as blobs:
        files = _write(target, made.read_contents(blobs))
    facts = {"crate": str(target), "runs": runs, "files": files}
    count = "1 run" if len(runs) == 1 else f"{len(runs)} runs"
    report_done(f"{target} holds {count} in {files} files.", facts)


def _read_program(path: Path) -> Program:
    """Raises BadInput."""
    try:
        return Program(path.name, path.read_bytes())
    except OSError as error:
        why = error.strerror or error
        raise BadInput(f"{path} cannot be read: {why}.", remedy="Name the application's file.") from None


def _check(target: Path) -> None:
    """Raises BadInput if the target exists already."""
    taken = any(target.iterdir()) if target.is_dir() else target.exists()
    if taken:
        raise BadInput(f"{target} already exists.", remedy="Name a new folder or file after --to.")


def _write(target: Path, files: Iterable[tuple[str, bytes]]) -> int:
    """Write a zip file, or else a folder; returns how many files it has. Raises SystemFailed."""
    number = 0
    try:
        if target.suffix.lower() == ".zip":
            return _write_zip(target, files)
        for path, data in files:
            make_folder((target / path).parent)
            with create_file(target / path) as out:
                out.write(data)
            number += 1
    except OSError as error:
        raise SystemFailed(f"{target} cannot be written: {error}.", remedy="Name another place.") from None
    return number


def _write_zip(target: Path, files: Iterable[tuple[str, bytes]]) -> int:
    """The zip file is complete or does not exist. Raises OSError."""
    number = 0
    beside = target.with_name(f".{target.name}.part")
    try:
        with create_file(beside) as out, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for path, data in files:
                entry = zipfile.ZipInfo(path, (1980, 1, 1, 0, 0, 0))
                entry.external_attr = 0o600 << 16
                archive.writestr(entry, data, zipfile.ZIP_DEFLATED)
                number += 1
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return number


@command.command("events")
@click.option(
    "--since",
    "moment",
    metavar="POSITION|TIME",
    callback=as_moment,
    help="Only events after this position of the log (0: all) or time.",
)
@click.option(
    "--family", "families", multiple=True, metavar="F", help="Only this family or type: run, action.failed …"
)
@click.option("-f", "--follow", is_flag=True, help="Show new events as they are added, until Ctrl-C.")
@click.option(
    "--to",
    "to",
    default="",
    metavar="FILE|kafka://BROKER:PORT/TOPIC",
    help="Append all new events to this file or Kafka topic.",
)
@file_option(
    "--settings",
    help="Settings of the Kafka client, one name=value in each line: certificates, names, passwords.",
)
@file_option(
    "--position",
    "position_file",
    help="The file that stores the position of the topic [default: kafka-TOPIC.json in the lab's folder].",
)
@click.option("--with-words", is_flag=True, help="Include texts that people wrote.")
@log_options
def events(
    where: Where,
    moment: Moment,
    families: tuple[str, ...],
    follow: bool,
    to: str,
    settings: Path | None,
    position_file: Path | None,
    with_words: bool,
) -> None:
    """Write events as CloudEvents 1.0, one JSON object a line.

    Payloads are the same as in the log. Texts that people wrote (reasons, notes, comments) are stored
    beside the log; --with-words adds them. `labos erase` cannot change exported events.

    `position` is the event's position in the log. Give the last one to --since: then no event is left out
    and none comes twice. `hash` is the event's hash in the chain. The command also works with LABOS_URL.
    With --to, it continues after the last event in the file or topic, so you can kill and restart it.

    Kafka receives events in order and at least once, all in partition 0 (extra `kafka`). If the broker is
    unavailable, the command waits for it, with --follow without limit. The lab never waits for the broker.

    \b
    labos export events > events.jsonl
    labos export events --family run --family intervention
    labos export events --since 2041 --follow
    labos export events --to events.jsonl --follow
    labos export events --to kafka://broker:9092/lab-events --settings kafka.properties --follow
    """
    check_types(families)
    if (settings or position_file) and not to.startswith(SCHEME):
        raise BadInput(
            "--settings and --position are only for Kafka.", remedy="Name a topic with --to kafka://…"
        )
    if to:
        if families or moment != Moment():
            raise BadInput("--to appends all events.", remedy="Leave --since and --family out.")
        _carry(where, to, follow, settings, position_file, stored=not with_words)
        return
    with open_log(where, stored=not with_words) as log, suppress(KeyboardInterrupt):
        seen = _start(log, moment)
        while True:
            end = log.head().position
            if end > seen:
                for record in log.select(LogQuery(after=seen, upto=end, types=families)):
                    click.echo(encode_cloudevent(record))
                seen = end
            if not follow:
                return
            time.sleep(POLL_S)


def _carry(
    where: Where, to: str, follow: bool, settings: Path | None, position_file: Path | None, *, stored: bool
) -> None:
    """Bring a file of JSON lines or a topic up to date with the log, and continue if the export follows the
    log."""
    if follow and hasattr(os, "nice"):
        os.nice(CALM)
    with (
        open_log(where, stored=stored) as log,
        suppress(KeyboardInterrupt),
        closing(_open_sink(where, log, to, follow, settings, position_file)) as sink,
    ):
        while True:
            end = log.head().position
            if end < sink.position:
                raise BadInput(f"{to} is at {sink.position}, the log at {end}: it belongs to another log.")
            while sink.position < end:
                upto = min(sink.position + BATCH, end)
                sink.write(log.select(LogQuery(after=sink.position, upto=upto)))
            if not follow:
                return
            time.sleep(POLL_S)


def _open_sink(
    where: Where, log: Log, to: str, follow: bool, settings: Path | None, position_file: Path | None
) -> JsonLines | KafkaSink:
    """Raises BadInput, SystemFailed."""
    if not to.startswith(SCHEME):
        if "://" in to:
            raise BadInput(
                f"{to} is not a target for events.", remedy="Name a file, or kafka://BROKER/TOPIC."
            )
        return JsonLines(Path(to))
    topic = KafkaTopic.parse(to)
    if position_file is None and where.lab:
        raise BadInput(
            "The position of the topic cannot be stored here: the lab is on another computer.",
            remedy="Name a file for it: --position FILE",
        )
    return KafkaSink(
        topic,
        log.head().lab,
        position_file or where.home / f"kafka-{topic.name}.json",
        read_settings(settings) if settings else {},
        patience_s=None if follow else BROKER_S,
        report=lambda words: click.echo(words, err=True),
    )


def _start(log: Log, moment: Moment) -> int:
    """The position after which the export begins. Raises BadInput for one that the log does not have."""
    if moment == Moment() or moment.position == 0:
        return 0
    return find_position_at(log, moment)
