"""Two requests with the same idempotency key count as one, if they are the same."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec

from labos.core.canonical import digest
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import plan_digest
from labos.core.experiments import ExperimentStarted
from labos.core.registry import Event
from labos.core.runs import RunSubmitted
from labos.errors import KeyReused
from labos.ports import LogQuery
from labos.services.log import Log, decode_event

E = TypeVar("E", bound=Event)


def make_digest_of_request(*whole: Any) -> str:
    """One digest of the whole request."""
    return digest(msgspec.json.encode(whole, order="deterministic"))


def expect_same_run(log: Log, key: str, run: str, asked: str) -> None:
    """Raises KeyReused if the run with this key comes from a different request."""
    first = _read_first(log, run, RunSubmitted)
    if first is not None and first.pins.get("request", asked) != asked:
        raise KeyReused(
            f"The key {key!r} belongs to {run}, {first.workflow!r} of {first.user}, which was asked for with "
            "another workflow, payload or options.",
            remedy=f"Give a new run a key of its own; the first one: labos runs {run}",
        )


def expect_same_experiment(log: Log, command: StartExperiment, experiment: str) -> None:
    """Raises KeyReused if the experiment with this key is a different one."""
    first = _read_first(log, experiment, ExperimentStarted)
    closing = plan_digest(command.closing) if command.closing is not None else ""
    asked = (command.name, command.user, closing, command.priority, command.parking)
    if first is not None and (first.name, first.user, first.closing, first.priority, first.parking) != asked:
        raise KeyReused(
            f"The key {command.request!r} belongs to {experiment}, {first.name!r} of {first.user}, which was "
            "started with another name, user, priority, parking or closing workflow.",
            remedy="Give a new experiment a key of its own.",
        )


def _read_first(log: Log, stream: str, kind: type[E]) -> E | None:
    record = next(iter(log.select(LogQuery(streams=(stream,), types=(kind.TYPE,)))), None)
    event = decode_event(record) if record is not None else None
    return event if isinstance(event, kind) else None
