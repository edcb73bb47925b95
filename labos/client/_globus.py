"""Globus services for an experiment, each with its events: flows, transfers, entries of a search index."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit

from labos.client._flows import FlowResult
from labos.client._record import ExperimentRecord, ServiceRecord
from labos.client._replay import Key, ReplayMismatch, as_json
from labos.client._transfers import Place, TransferFailed, Transferred, read_transfer
from labos.errors import BadInput

if TYPE_CHECKING:
    from labos.services.globus import GlobusCarrier, GlobusFlow, GlobusIndex

T = TypeVar("T")

SCHEME = "globus://"


def run_flow(record: ExperimentRecord, key: Key, flow: GlobusFlow, given: Mapping[str, Any]) -> FlowResult:
    """Let Globus carry out a flow. Raises GlobusError, ReplayMismatch for another flow or another input."""
    from labos.services.globus import run_once

    now = {"globus_flow": flow.flow, "input": as_json(given)}
    begun = {"state": "started", "flow_id": str(key), "where": "globus", **now}
    before = record.keep(f"{key} started", "flow", flow.name, begun)["facts"]
    if {name: before.get(name) for name in now} != now:
        raise ReplayMismatch(record.experiment, key, before, begun)
    ended = record.find_note(f"{key} ended")
    for attempt in range(1, flow.attempts + 1):
        if ended is not None:
            break
        run = run_once(flow, record.find_sent(f"{key} attempt {attempt}", "Globus Flows"), given)
        run_facts = {"flow_id": str(key), "globus_run": run.id, "states": run.states}
        if run.status == "SUCCEEDED":
            output = record.json_as_facts(as_json(run.output))
            ended = record.keep(
                f"{key} ended", "flow", flow.name, {"state": "succeeded", **run_facts, **output}
            )
        else:
            last = attempt == flow.attempts
            name = f"{key} ended" if last else f"{key} attempt {attempt} failed"
            state = "failed" if last else "retrying"
            note = record.keep(
                name, "flow", flow.name, {"state": state, **run_facts, "attempt": attempt, "error": run.why}
            )
            ended = note if last else None
    assert ended is not None
    facts = ended["facts"]
    if facts["state"] == "succeeded":
        return FlowResult(flow.name, "succeeded", {"input": now["input"], "output": record.json_of(facts)})
    step = facts["states"][-1]["state"] if facts["states"] else ""
    return FlowResult(flow.name, "failed", {"input": now["input"]}, step, facts["error"])


def is_globus(place: Place) -> bool:
    return isinstance(place, str) and place.startswith(SCHEME)


def transfer(
    record: ExperimentRecord,
    key: Key,
    source: Place,
    target: Place,
    carrier: GlobusCarrier | None,
    sha256: str,
) -> Transferred:
    """Let Globus copy a file from one collection to another. Raises TransferFailed, GlobusError,
    ReplayMismatch."""
    from labos.services.globus import GlobusFailed, GlobusPlace, transfer_once

    if not (is_globus(source) and is_globus(target)):
        raise BadInput(
            "Globus transfers files between two collections.",
            remedy="Name both places as globus://<collection>/<path>, or transfer to a folder of a "
            "collection first, and from there.",
        )
    if carrier is None:
        raise BadInput(
            "The program has no credentials for Globus Transfer.",
            remedy="Give configure_transfer(globus=labos.services.globus.GlobusCarrier(…)) first.",
        )
    request = {"source": str(source), "target": str(target)}
    known = record.find_note(key)
    if known is None:
        begun = perf_counter()
        places = GlobusPlace.parse(request["source"]), GlobusPlace.parse(request["target"])
        try:
            moved = attempts_of(
                record,
                key,
                "Globus Transfer",
                lambda sent: transfer_once(
                    carrier, sent, *places, sha256=sha256, label=f"LabOS {record.experiment}"
                ),
            )
        except GlobusFailed as error:
            raise TransferFailed(
                f"{request['source']} was not transferred to {request['target']}: {error}",
                remedy="The failure is in the log; transfer it again.",
            ) from error
        facts = {
            **request,
            "where": "globus",
            "task": moved.task,
            "sha256": moved.sha256,
            "bytes": moved.bytes,
        }
        facts["seconds"] = round(perf_counter() - begun, 6)
        known = record.keep(key, "transfer", urlsplit(request["target"]).path.rpartition("/")[2], facts)
    return read_transfer(record, key, known["facts"], request)


def ingest(record: ExperimentRecord, key: Key, index: GlobusIndex, content: Mapping[str, Any]) -> None:
    """Put a publication into an index. Raises GlobusError."""
    from labos.services.globus import ingest_once

    if record.find_note(f"{key} indexed") is not None:
        return
    subject = f"labos:{record.past.seed}/{key}"
    task = attempts_of(record, key, "Globus Search", lambda sent: ingest_once(index, sent, subject, content))
    facts = {"state": "indexed", "of": str(key), "index": index.index, "subject": subject, "task": task}
    record.keep(f"{key} indexed", "flow", "Globus Search", facts)


def attempts_of(record: ExperimentRecord, key: Key, service: str, once: Callable[[ServiceRecord], T]) -> T:
    """The result of the first attempt that has not failed. A failure is recorded, and the next call is
    another attempt. Raises GlobusError."""
    from labos.services.globus import GlobusFailed

    attempt = 1
    while record.find_note(f"{key} attempt {attempt} failed") is not None:
        attempt += 1
    sent = record.find_sent(f"{key} attempt {attempt}", service)
    try:
        return once(sent)
    except GlobusFailed as error:
        sent.keep("failed", {"attempt": attempt, "error": str(error)[:500]})
        raise
