"""The requests and facts that an experiment sends to the lab, each only once, however often its program is
started."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import msgspec

from labos.client._answers import LabUnreachable
from labos.client._replay import (
    CallKeys,
    ExperimentPast,
    Key,
    as_json,
    as_sent,
    check_note,
    check_run,
    make_short_digest,
    name_of,
)
from labos.core.canonical import digest, encode_canonical
from labos.errors import CommitInDoubt, KeyReused, LabosError, NotFound, Refused

if TYPE_CHECKING:
    from labos.client._batches import BatchRun
    from labos.client._experiment import Experiment

LARGEST_IN_EVENT = 16 * 1024
"""The largest number of bytes of a result in its event; a larger one is stored as a file of the lab."""

KINDS = {
    "submit": "run",
    "submit_all": "runs",
    "submit_compute": "compute",
    "compute_all": "computes",
    "decide": "decision",
    "run_flow": "flow",
    "publish": "publication",
}
"""The kind of call in a key, where it differs from the name of the method."""


class ExperimentRecord:
    """The record of one experiment."""

    def __init__(self, experiment: Experiment) -> None:
        self._of = experiment
        self._keys = CallKeys()
        self.past = ExperimentPast(experiment.lab, "")

    @property
    def experiment(self) -> str:
        return self._of.id

    def begin(self, experiment: str) -> ExperimentPast:
        """Read what the log has of an experiment. Raises NotFound."""
        self.past = ExperimentPast(self._of.lab, experiment).read()
        if not self.past.status:
            raise NotFound(
                f"There is no experiment {experiment!r}.",
                remedy="List them: labos experiments --all",
            )
        return self.past

    def take(self, method: str, what: Any, given: str = "") -> Key:
        """The key of a call of a method of the experiment, about a workflow, a file, a function or a name."""
        about = function_name(what) if callable(what) else str(what)
        if method in ("run", "submit", "submit_all", "transfer"):
            about = name_of(what)
        return self._keys.take(KINDS.get(method, method), about, given)

    @contextmanager
    def keep_key_on_failure(self, key: Key, *failures: type[LabosError]) -> Iterator[None]:
        """If a call was not answered, or failed without a trace in the log, it may be repeated under the same
        key."""
        without_trace: tuple[type[LabosError], ...] = (LabUnreachable, *failures)
        try:
            yield
        except without_trace:
            self._keys.give_back(key)
            raise

    # -- runs --------------------------------------------------------------------------------

    def request_of(self, key: Key) -> str:
        """The key of the request for a run."""
        name = f"{self.experiment}/{key}"
        is_plain = name.isascii() and name.isprintable()
        return name if is_plain else f"{self.experiment}/{make_short_digest(key)}"

    def find_run(self, key: Key, asked: BatchRun) -> str:
        """The run in the log for a request; empty if there is none. Raises ReplayMismatch."""
        recorded = self.past.runs.get(asked.key)
        if recorded is None:
            return ""
        check_run(self.experiment, key, recorded, asked.workflow["text"], asked.payload)
        return str(recorded["run"])

    @contextmanager
    def expect_same(self, key: Key, runs: Sequence[BatchRun]) -> Iterator[None]:
        """If the lab knows the key of a requested run with different content, raise ReplayMismatch with the
        difference."""
        try:
            yield
        except KeyReused:
            self._read_past_again()
            for run in runs:
                self.find_run(key, run)
            raise

    # -- notes -------------------------------------------------------------------------------

    def note(self, kind: str, name: str, facts: Mapping[str, Any]) -> None:
        """Log a fact once. Raises ReplayMismatch if the program has taken a different path than before."""
        key = self._keys.take(kind, name)
        with self.keep_key_on_failure(key):
            check_note(self.experiment, self.keep(key, kind, name, facts), facts)

    def find_note(self, key: str) -> dict[str, Any] | None:
        """The facts in the log under the key of a note, as far as the log has been read."""
        return self.past.notes.get(key)

    def keep(self, key: str, kind: str, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        """Log a note under its key, once; returns what the log has under it."""
        lab, user = self._of.lab, self._of.user
        while (known := self.find_note(key)) is None:
            try:
                lab.note(self.experiment, kind, name, facts, user, key=str(key))
            except (LabUnreachable, CommitInDoubt):
                self._read_past_again()  # the lab may have received it: read the log
            except Refused:
                if self._read_past_again().notes.get(key) is None:
                    raise  # else the killed program has logged it
            else:
                return {"kind": kind, "name": name, "facts": as_sent(facts), "key": key}
        return known

    def decide(self, key: Key, name: str, function: Callable[[], Any]) -> Any:
        """The result of a function, now or in the earlier program."""
        with self.keep_key_on_failure(key):
            known = self.find_note(key)
            if known is None:
                known = self.keep(key, "decision", name, self.json_as_facts(as_json(function())))
            return self.json_of(known["facts"])

    def find_sent(self, key: str, service: str) -> ServiceRecord:
        """The log's record of a request to an external service."""
        return ServiceRecord(self, key, service)

    def give_back(self, key: str) -> None:
        """The call has no result: a repetition has the same key."""
        self._keys.give_back(key)

    # -- values ------------------------------------------------------------------------------

    def json_as_facts(self, value: Any) -> dict[str, Any]:
        """A JSON value as facts of a note: itself, or the file of the lab that holds it."""
        content = encode_canonical(value)
        if len(content) <= LARGEST_IN_EVENT:
            return {"value": value}
        return {"value_file": self.keep_file(content)}

    def json_of(self, facts: Mapping[str, Any]) -> Any:
        """The value that ``json_as_facts`` has stored."""
        return (
            msgspec.json.decode(self.file(facts["value_file"])) if "value_file" in facts else facts["value"]
        )

    def keep_file(self, content: bytes) -> str:
        """Store a file in the lab; returns its SHA-256. An experiment that has ended accepts no more files:
        those of its earlier calls are stored already."""
        if self.past.status in ("closing", "ended"):
            with suppress(NotFound):
                self.file(digest(content))
                return digest(content)
        return self._of.lab.keep_file(self.experiment, content, self._of.user)

    def file(self, sha256: str) -> bytes:
        """Raises NotFound, LogDamaged."""
        return self._of.lab.file(sha256)

    def _read_past_again(self) -> ExperimentPast:
        self.past.lab = self._of.lab
        return self.past.read()


class ServiceRecord:
    """The log's record of a request to an external service, under the key of its call: a note of kind
    ``flow`` before it is sent, and another one after it has arrived."""

    def __init__(self, record: ExperimentRecord, key: str, service: str) -> None:
        self._record, self._key, self._service = record, key, service
        self.of = record.experiment
        self.mark = f"{record.past.seed}/{key}"

    def find_own(self, name: str) -> Mapping[str, Any] | None:
        return self._facts(f"{self._key} {name}")

    def keep(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        return self._keep(f"{self._key} {name}", {"state": name, "of": self._key, **facts})

    def find_shared(self, name: str) -> Mapping[str, Any] | None:
        return self._facts(f"{self._service}: {name}")

    def keep_shared(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        return self._keep(f"{self._service}: {name}", {"state": name, **facts})

    def list_known(self, fact: str) -> set[str]:
        notes = list(self._record.past.notes.values())
        return {
            str(note["facts"][fact])
            for note in notes
            if note["name"] == self._service and fact in note["facts"]
        }

    def _facts(self, key: str) -> dict[str, Any] | None:
        note = self._record.find_note(key)
        return None if note is None else note["facts"]

    def _keep(self, key: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        note = self._record.past.notes.setdefault(key, self._record.keep(key, "flow", self._service, facts))
        kept: dict[str, Any] = note["facts"]
        return kept


def function_name(function: Callable[..., Any]) -> str:
    """The name of a computation in keys and notes."""
    from labos.services.compute._work import make_name as name_of_function

    return name_of_function(function)
