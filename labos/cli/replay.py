"""``labos replay``: through any log step by step, with the state at each event."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import click
import msgspec

from labos.cli._options import json_option_saying
from labos.cli._out import show_json, show_line, wants_json
from labos.cli._query import Where
from labos.core.envelope import Record
from labos.core.state import LabState, hash_state
from labos.core.wells import sort_by_well
from labos.core.words import Kept
from labos.errors import BadInput
from labos.ports import StoredWords
from labos.services.catalogue import Catalogue
from labos.services.describe import describe
from labos.services.log import decode_event
from labos.services.shown import WordsBeside, show_text
from labos.services.steps import LogStep, StateChange, iterate_steps, make_plain_state
from labos.services.times import iso_time, show_time
from labos.store import open_store, read_backup, read_segment, read_words_copy, records_of

WIDEST = 100
HELP = "Enter: next event; a number: on to that position; s: the state; s WORD: its parts with WORD; q: end"


@click.command("replay", short_help="Step through any log, with the state at each event.")
@click.argument("log", metavar="LOG")
@click.option("--at", type=click.IntRange(min=1), metavar="N", help="Show the whole state after position N.")
@click.option("--from", "first", type=click.IntRange(min=1), metavar="A", help="Begin at position A.")
@click.option("--to", "last", type=click.IntRange(min=1), metavar="B", help="End at position B.")
@click.option("--hash", "only_hash", is_flag=True, help="Print only the hash of the state at the end.")
@json_option_saying("JSON: one line for each event, with its changes.")
def command(log: str, at: int | None, first: int | None, last: int | None, only_hash: bool) -> None:
    """Replay LOG, event by event, and show what each event changed. LOG is a lab's folder, its database (a
    file or a URL), a backup, or a file of records from labos log --json.

    \b
    labos replay lab                          in a terminal: step by step
    labos replay lab --at 120                 the state after event 120
    labos replay lab.jsonl --from 90 --to 99  ten events and what they changed
    labos replay /safe/lab --hash             the hash of the state at its end

    Texts that people wrote are stored beside the log. They are shown unless they were erased. The state,
    its hash and --json contain only references to them, so an erasure does not change these.

    Nothing is written. If the log has events that this LabOS does not know, the command is refused. If the
    log contradicts itself, the replay ends at the first wrong event.
    """
    if at is not None and (first or last):
        raise click.UsageError(
            "--at shows the state at one position; --from and --to select a range of events. Use "
            "only one of the two."
        )
    state = LabState()
    with _open_records(log) as (records, beside):
        if at is not None or only_hash:
            for _ in iterate_steps(records, state, sys.maxsize, at if at is not None else last):
                pass
            _expect(log, state, at)
            _show_end(state, only_hash)
        elif (
            not wants_json() and first is None and last is None and sys.stdin.isatty() and sys.stdout.isatty()
        ):
            _walk(iterate_steps(records, state, 1, None), state, beside)
        else:
            names = Catalogue()
            for step in iterate_steps(_learn_names(records, names), state, first or 1, last):
                _show(step, names, beside)
            _expect(log, state, first)


def _expect(log: str, state: LabState, position: int | None) -> None:
    if position is not None and state.position < position:
        raise BadInput(f"{log} ends at position {state.position}.", remedy="Name a position up to there.")


def _show_end(state: LabState, only_hash: bool) -> None:
    if only_hash and not wants_json():
        click.echo(f"{state.position} {hash_state(state)}")
    elif only_hash:
        show_json({"position": state.position, "state": hash_state(state)})
    else:
        # As it is folded, without a conversion.
        click.echo(msgspec.json.format(msgspec.json.encode(make_plain_state(state)), indent=2))


def _show(step: LogStep, names: Catalogue, beside: WordsBeside) -> None:
    head = step.record.head
    if wants_json():
        show_line(
            {
                "position": head.position,
                "type": head.type,
                "time": iso_time(head.recorded_at),
                "event": msgspec.to_builtins(step.event),
                "changes": step.changes,
            }
        )
        return
    kind = click.style(f"{head.type:<22}", fg="cyan")
    description = describe(step.event, head, names)
    lines = [f"{head.position:>6}  {show_time(head.recorded_at)}  {kind} {description}"]
    lines += [f"          {_line(change)}" for change in step.changes]
    click.echo(show_text(beside, "\n".join(lines)))


def _line(change: StateChange) -> str:
    if change.before == "absent":
        return f"+ {change.path} = {_shorten_value(change.after)}"
    if change.after == "absent":
        return f"- {change.path} (was {_shorten_value(change.before)})"
    return f"~ {change.path}: {_shorten_value(change.before)} -> {_shorten_value(change.after)}"


def _shorten_value(value: Any) -> str:
    text = msgspec.json.encode(sort_by_well(value)).decode()
    return text if len(text) <= WIDEST else f"{text[:WIDEST]}… ({len(text)} characters)"


def _walk(found: Iterator[LogStep], state: LabState, beside: WordsBeside) -> None:
    """Step by step, under the control of a user at a terminal."""
    click.echo(HELP)
    names, upto = Catalogue(), 0
    for step in found:
        names.learn(step.event)
        if step.record.head.position < upto:
            continue
        _show(step, names, beside)
        while True:
            answer = click.prompt("", default="", show_default=False, prompt_suffix="> ").strip()
            if answer == "q":
                return
            if answer.isdigit():
                upto = int(answer)
                break
            if not answer:
                break
            if answer == "s" or answer.startswith("s "):
                _show_state(state, answer[2:].strip(), beside)
            else:
                click.echo(HELP)


def _show_state(state: LabState, word: str, beside: WordsBeside) -> None:
    for path, value in _iterate_leaves("", make_plain_state(state)):
        if word in path or (word and word in str(value)):
            click.echo(show_text(beside, f"{path} = {_shorten_value(value)}"))


def _iterate_leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from _iterate_leaves(f"{path}.{key}" if path else str(key), item)
    else:
        yield path, value


def _learn_names(records: Iterator[Record], names: Catalogue) -> Iterator[Record]:
    for record in records:
        names.learn(decode_event(record))
        yield record


class _Words:
    """Words outside a database."""

    def __init__(self, words: Iterable[StoredWords] = ()) -> None:
        self._known = {each.words.reference: each.words for each in words}

    def words_of(self, references: Iterable[str]) -> dict[str, Kept]:
        return {name: self._known[name] for name in references if name in self._known}


@contextmanager
def _open_records(log: str) -> Iterator[tuple[Iterator[Record], WordsBeside]]:
    """The records of a log of any kind, and its words. Raises BadInput."""
    path = Path(log)
    if "://" in log:
        url = log
    elif path.is_dir() and (path / "backup.json").exists():
        yield records_of(path, read_backup(path)), _Words(read_words_copy(path))
        return
    elif path.is_dir():
        url = _find_database(path)
    elif path.is_file():
        with path.open("rb") as file:
            is_database = file.read(15) == b"SQLite format 3"
        if not is_database:
            yield read_segment(path), _Words()
            return
        url = f"sqlite:///{path.absolute()}"
    else:
        raise BadInput(
            f"{log} does not exist.", remedy="Name a lab's folder, a database, a backup or a file."
        )
    with closing(open_store(url, create=False, read_only=True)) as store:
        yield store.read(), store


def _find_database(home: Path) -> str:
    if not (home / "labos.db").exists() and not (home / "kernel.json").exists():
        raise BadInput(f"{home} contains neither a lab nor a backup.", remedy="Name another folder.")
    return Where(home.absolute()).url
