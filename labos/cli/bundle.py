"""``labos bundle``: a run, an experiment or a campaign as a file that contains its own proof."""

from __future__ import annotations

from pathlib import Path

import click

from labos.cli._complete import make_completer
from labos.cli._options import file_option
from labos.cli._out import report_done, write_new
from labos.cli._query import Where, folder_and_json, open_database
from labos.errors import NotFound
from labos.services.trust.bundle import AboutBundle, Attachments, make_bundle, note_beside
from labos.services.trust.keys import SigningKeys
from labos.services.trust.notes import parse_note
from labos.services.trust.places import find_newest
from labos.services.trust.publish import FOLDER
from labos.store import open_blobs


@click.command("bundle", short_help="Write a run, experiment or campaign to a file with its proof.")
@click.argument("subject", metavar="ID", shell_complete=make_completer("run", "experiment"))
@file_option("-o", "--output", "file", required=True, help="The file to write.")
@file_option(
    "--checkpoint",
    "checkpoint",
    help="The checkpoint for the proof (default: the newest in checkpoints/ of the lab's folder).",
)
@click.option(
    "--without-words", is_flag=True, help="Leave out texts that people wrote; the bundle still verifies."
)
@folder_and_json
def command(where: Where, subject: str, file: Path, checkpoint: Path | None, without_words: bool) -> None:
    """Write a run's events, plan and files to FILE, with the proof that they are in the log of a signed
    checkpoint. For an experiment or a campaign, write its own events and those of all its runs. With the
    lab's public key, anybody can check the file without network and without the lab:

    \b
    labos checkpoint
    labos bundle R7 -o R7.zip
    labos verify --bundle R7.zip --public-key lab.pub

    The bundle includes texts that people wrote (reasons, notes, comments), unless they were erased. `labos
    erase` cannot change a bundle that was already passed on.
    """
    data, about = make_bundle_of(where, subject, checkpoint, words=not without_words)
    write_new(file, data)
    message = f"{file} holds {about.events} events and {about.blobs} files of {subject}"
    report_done(f"{message}, proven by the checkpoint of size {about.size}.", about)


def make_bundle_of(
    where: Where, subject: str, checkpoint: Path | None = None, *, words: bool = True
) -> tuple[bytes, AboutBundle]:
    """The bundle of a run, an experiment or a campaign, for the given checkpoint or the lab's newest one;
    with or without people's words. Raises NotFound, Refused, LogDamaged."""
    path = checkpoint or find_newest(where.home / FOLDER)
    if path is None:
        raise NotFound("This lab has no signed checkpoint yet.", remedy="Make one: labos checkpoint")
    try:
        note, stamp = note_beside(path)
    except OSError as error:
        raise NotFound(
            f"The checkpoint {path} cannot be read: {error.strerror or error}.",
            remedy="Name one that labos checkpoint has made: a file that ends in .note.",
        ) from None
    beside = Attachments(parse_note(note), stamp, SigningKeys(where.home).read_rotations(), words)
    with open_database(where) as store:
        return make_bundle(store, open_blobs(where.settings.blobs), subject, beside)
