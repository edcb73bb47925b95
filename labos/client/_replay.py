"""The log's record of an experiment, by the calls of its application: it lets a restarted application
continue.

Each call that sends a request to the lab has a key: one that the program gives; else the kind of call, its
subject, and how often the program has made such a call before (``run cp_mixcolor#3``). The key of a run is
the key of its request; a note has its key as a field.
"""

from __future__ import annotations

import hashlib
import threading
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from labos.client._calls import make_plain
from labos.core.canonical import digest, encode_canonical
from labos.errors import BadInput, LabosError

if TYPE_CHECKING:
    from labos.client._lab import LabClient

LONGEST_KEY = 150
"""The largest number of characters of a key; the rest of a longer one is replaced by a digest."""

SHOWN = 300
"""The number of characters of the request, and of the record, that an error shows."""

TYPES = ("experiment", "run.submitted")

STEERING = ("decision", "condition_checked")
"""Notes that determine the path of the program: they must be the same in a restarted program. Others may
contain a time."""


class ReplayMismatch(LabosError):
    """A restarted program makes a different request than before, under the same key.

    ``key`` names the call; ``recorded`` is the request in the log, ``now`` the program's request. The
    experiment stays open.
    """

    def __init__(self, experiment: str, key: str, recorded: Any, now: Any) -> None:
        super().__init__(
            f"{experiment} has a different {key!r} in the log. In the log: {_shorten(recorded)}. Now: "
            f"{_shorten(now)}.",
            remedy="Use experiment.decide or experiment.random for times, files and random numbers, so that "
            "a repetition gets the same values; give calls whose order can change their own keys.",
        )
        self.experiment, self.key, self.recorded, self.now = experiment, key, recorded, now


class Key(str):
    """The key of a call."""


class CallKeys:
    """Gives calls their keys, in the order in which the program makes them."""

    def __init__(self) -> None:
        self._taken: Counter[str] = Counter()
        self._lock = threading.Lock()

    def take(self, kind: str, what: str, given: str = "") -> Key:
        """The key of the next call of a kind with this subject, or the ``given`` key."""
        if isinstance(given, Key):
            return given
        if given:
            return Key(_shorten_name(f"{kind} {given}"))
        name = _shorten_name(f"{kind} {what}")
        with self._lock:
            self._taken[name] += 1
            return Key(f"{name}#{self._taken[name]}")

    def give_back(self, key: str) -> None:
        """The call was not answered: a repetition has the same key."""
        name, _, number = key.rpartition("#")
        with self._lock:
            if number == str(self._taken.get(name)):
                self._taken[name] -= 1


class ExperimentPast:
    """The log's record of an experiment. ``status``: open, cancelled, closing or ended."""

    def __init__(self, lab: LabClient, experiment: str) -> None:
        self.lab, self._experiment = lab, experiment
        self._position = 0
        self._reading = threading.Lock()
        self.status = ""
        self.name, self.user, self.seed = "", "", ""
        self.runs: dict[str, dict[str, Any]] = {}
        """The submitted runs, by the key of the request."""
        self.notes: dict[str, dict[str, Any]] = {}
        """The notes, by their key."""
        self.strays: list[str] = []
        """Runs without a key of the program."""

    def read(self) -> ExperimentPast:
        """Read up to the present end of the log. Raises LabUnreachable."""
        with self._reading:
            for event in self.lab.events(self._position, type=list(TYPES), correlation=self._experiment):
                self._fold(event["type"], event["payload"], event)
                self._position = event["position"]
        return self

    def _fold(self, kind: str, payload: dict[str, Any], event: Mapping[str, Any]) -> None:
        match kind:
            case "experiment.started":
                self.status, self.name, self.user = "open", payload["name"], payload["user"]
                self.seed = event["id"]
            case "experiment.cancelled" | "experiment.closing" | "experiment.ended":
                self.status = kind.partition(".")[2]
            case "experiment.noted" if payload.get("key"):
                self.notes.setdefault(payload["key"], payload)
            case "run.submitted" if not payload.get("closing"):
                request = payload.get("request", "")
                if request.startswith(f"{self._experiment}/"):
                    self.runs[request] = payload
                else:
                    self.strays.append(payload["run"])


def name_of(workflow: Any) -> str:
    """The name of a workflow in keys: the name of its file, without its folder."""
    if isinstance(workflow, Mapping):
        workflow = workflow.get("name", "") or "workflow"
    path = Path(str(workflow))
    return path.stem if path.suffix in (".yaml", ".yml") else path.name


def as_json(value: Any) -> Any:
    """A value in the form in which the log returns it: a tuple as a list, an array as lists. Raises BadInput
    for a value that JSON cannot hold."""
    try:
        return msgspec.json.decode(encode_canonical(msgspec.to_builtins(value, enc_hook=make_plain)))
    except (ValueError, TypeError, OverflowError, RecursionError, msgspec.MsgspecError) as error:
        raise BadInput(
            f"A {type(value).__name__} cannot be written into the log: {error}.",
            remedy="Give finite numbers, texts, and lists and tables of these.",
        ) from None


def plain_digest(value: Any) -> str:
    """A digest that is the same for equal values, also in another process: of their JSON, with arrays as
    digests. Empty for a value that has none."""
    try:
        return digest(encode_canonical(msgspec.to_builtins(value, enc_hook=_array_or_plain)))
    except (LabosError, ValueError, TypeError, OverflowError, RecursionError, msgspec.MsgspecError):
        return ""


def _array_or_plain(value: Any) -> Any:
    kind, to_bytes = getattr(value, "dtype", None), getattr(value, "tobytes", None)
    if kind is not None and to_bytes is not None and not getattr(kind, "hasobject", False):
        return {"array": str(kind), "shape": list(getattr(value, "shape", ())), "sha256": digest(to_bytes())}
    return make_plain(value)


def check_run(experiment: str, key: str, recorded: Mapping[str, Any], text: str, payload: Any) -> None:
    """Raises ReplayMismatch for a run of another workflow, or with another payload."""
    now = as_sent(payload or {})
    if recorded["payload"] != now:
        raise ReplayMismatch(experiment, key, recorded["payload"], now)
    before, is_now = recorded["pins"].get("workflow", ""), digest(text.encode())
    if before and before != is_now:
        name = recorded["workflow"]
        raise ReplayMismatch(
            experiment, key, f"{name}, file {before[:12]}", f"{name}, changed, file {is_now[:12]}"
        )


def check_note(experiment: str, recorded: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
    """Raises ReplayMismatch if the program takes a different path than before."""
    if recorded["kind"] in STEERING:
        now = as_sent(facts)
        if recorded.get("facts", {}) != now:
            raise ReplayMismatch(experiment, recorded["key"], recorded.get("facts", {}), now)


def as_sent(value: Any) -> Any:
    """A value in the form in which it was sent to the lab."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=make_plain))


def _shorten_name(name: str) -> str:
    line = "".join(char if char.isprintable() else " " for char in name)
    return (
        line
        if line == name and len(line) <= LONGEST_KEY
        else f"{line[: LONGEST_KEY - 17]}~{make_short_digest(name)}"
    )


def make_short_digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:16]


def _shorten(value: Any) -> str:
    text = value if isinstance(value, str) else msgspec.json.encode(value).decode()
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
