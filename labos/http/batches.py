"""Runs that are submitted together: a workflow, and a payload for each run."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import msgspec

from labos.core.decide.composites import SubmitRuns
from labos.core.decide.stock import LoadStation
from labos.core.ids import RunId
from labos.core.runs import RunSubmitted
from labos.errors import BadInput
from labos.http.placing import make_loads
from labos.http.repeats import expect_same_run, make_digest_of_request
from labos.http.service import LabService, WorkflowText, digest_files, digest_of_run
from labos.services.times import parse_due
from labos.spec import Compiled
from labos.spec.findings import Finding, SpecErrors

if TYPE_CHECKING:
    from labos.http.bodies import NewRuns


async def submit_batch(
    service: LabService, asked: NewRuns, key: str
) -> tuple[list[str], tuple[Finding, ...]]:
    """Queue a run for each payload, in one command; returns their ids, and the warnings. A run whose key is
    in the log is not submitted again; Refused if its request was a different one. Errors name the payload."""
    _check_lists(asked)
    service.expect_role(asked.user, "submitter")
    service.expect_own(asked.experiment, asked.user)
    keys = asked.keys or [f"{key}-{asked.first + n}" if key else "" for n in range(len(asked.payloads))]
    digests = await _list_digests(service, asked)
    known = _find_known(service, keys)
    await _expect_same(service, asked, keys, digests, known)
    if len(known) == len(keys):
        return [str(known[number]) for number in range(len(keys))], ()
    due_at = parse_due(asked.due, service.kernel.clock.now_ns())
    workcell = await service.find_workcell_for(asked.workflow, asked.workcell)
    loads = [] if known else make_loads(service, asked.place, workcell, asked.user)
    compiled = await _compile_each(service, asked, workcell, loads)
    commands = tuple(
        service.make_run(
            asked,
            _text_of(asked, number),
            each,
            payload=asked.payloads[number],
            whole=digests[number],
            request=keys[number],
            due_at=due_at,
        )
        for number, each in enumerate(compiled)
    )
    events = await service.kernel.execute(SubmitRuns(commands, tuple(loads), asked.first), asked.user)
    new = [event for event in events if isinstance(event, RunSubmitted)]
    found = _find_known(service, keys) if any(keys) else {n: event.run for n, event in enumerate(new)}
    is_new = {event.run for event in new}
    meanwhile = {n: run for n, run in found.items() if run not in is_new and n not in known}
    await _expect_same(service, asked, keys, digests, meanwhile)
    runs = [found[number] for number in range(len(keys))]
    findings = [finding for each in compiled for finding in each.findings]
    findings += [finding for run in runs for finding in service.without_gap(run)]
    return list(map(str, runs)), tuple(dict.fromkeys(findings))


def _check_lists(asked: NewRuns) -> None:
    for name in ("keys", "files"):
        found = getattr(asked, name)
        if found and len(found) != len(asked.payloads):
            raise BadInput(
                f"There are {len(asked.payloads)} payloads, but {len(found)} {name}.",
                remedy=f"Send one entry of `{name}` for each payload, or none.",
            )


def _text_of(asked: NewRuns, number: int) -> WorkflowText:
    """The workflow of one payload, with the files for this payload."""
    if not asked.files:
        return asked.workflow
    files = asked.workflow.files
    return msgspec.structs.replace(
        asked.workflow, files={name: files[name] for name in asked.files[number] if name in files}
    )


async def _list_digests(service: LabService, asked: NewRuns) -> list[str]:
    """The digest of each run's request, equal to the digest of a single request for this run."""
    files = await asyncio.to_thread(digest_files, asked.workflow.files)
    return [
        digest_of_run(asked, {name: files[name] for name in _text_of(asked, number).files}, payload)
        for number, payload in enumerate(asked.payloads)
    ]


def _find_known(service: LabService, keys: Sequence[str]) -> dict[int, RunId]:
    """The runs that are in the log under these keys, by their numbers."""
    requests = service.kernel.state.runs.requests
    return {number: requests[key] for number, key in enumerate(keys) if key and key in requests}


async def _expect_same(
    service: LabService, asked: NewRuns, keys: Sequence[str], digests: Sequence[str], known: dict[int, RunId]
) -> None:
    if not known:
        return
    await service.kernel.flush()

    def compare() -> None:
        for number, run in known.items():
            with _payload_named(asked, number):
                expect_same_run(service.parts.store, keys[number], run, digests[number])

    await asyncio.to_thread(compare)


async def _compile_each(
    service: LabService, asked: NewRuns, workcell: str, loads: Sequence[LoadStation]
) -> list[Compiled]:
    """The plan of each payload; equal payloads share one plan."""
    plans: dict[str, Compiled] = {}
    found = []
    for number, payload in enumerate(asked.payloads):
        text = _text_of(asked, number)
        same = make_digest_of_request(payload, sorted(text.files))
        if same not in plans:
            with _payload_named(asked, number):
                plans[same] = await service.compile(text, payload, workcell, loads)
        found.append(plans[same])
    return found


@contextmanager
def _payload_named(asked: NewRuns, number: int) -> Iterator[None]:
    """An error that is raised for one payload names this payload, and says that nothing was submitted."""
    name = f"payloads[{asked.first + number}]: "
    try:
        yield
    except SpecErrors as error:
        raise SpecErrors(
            msgspec.structs.replace(finding, message=f"{name}{finding.message}")
            if finding.severity == "error"
            else finding
            for finding in error.findings
        ) from None
    except BadInput as error:
        error.message = f"{name}{error.message}"
        raise
