"""Flows that Globus carries out: each is started once, and its end is awaited."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import msgspec

from labos.services.compute import SendingRecord
from labos.services.globus._asking import GlobusAccess, GlobusRefused, ask, send_once, wait_for

SERVICE = "Globus Flows"
MOST_RUNS = 500
"""At most so many of a flow's last runs are searched for the run whose answer was lost."""

ENDS = ("SUCCEEDED", "FAILED", "ENDED")


class GlobusFlow(GlobusAccess):
    """A flow in Globus Flows: its id, and how the program authenticates (see `GlobusAccess`). A run that
    fails is started again, at most ``attempts`` times in all."""

    service = SERVICE

    name: str
    flow: str
    attempts: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        self.attempts = max(self.attempts, 1)

    def __str__(self) -> str:
        return self.name

    @cached_property
    def starts(self) -> Any:
        """The client with the right to start it."""
        return self.open_client("SpecificFlowClient", self.flow)

    @cached_property
    def looks(self) -> Any:
        """The client with the right to read its runs."""
        return self.open_client("FlowsClient")


class GlobusRun(msgspec.Struct, frozen=True):
    """A run of a flow that has ended. ``status``: SUCCEEDED, FAILED, or ENDED (cancelled); ``states`` are the
    entries of its log for each state, in order; ``output`` is its result, ``why`` the reason of a failure."""

    id: str
    status: str
    states: list[dict[str, str]]
    output: Any = None
    why: str = ""


def run_once(flow: GlobusFlow, sent: SendingRecord, given: Mapping[str, Any]) -> GlobusRun:
    """Start a flow, or find the run that was started before; wait for its end. The run has a tag of ours, by
    which it is found if the answer was lost. Raises GlobusRefused, GlobusUnreachable."""
    tag = f"labos-{hashlib.sha256(sent.mark.encode()).hexdigest()[:32]}"
    known = sent.find_own("sent")
    if known is None:
        run = _find(flow, tag) if sent.find_own("sending") is not None else None
        if run is None:
            sent.keep("sending", {"globus_flow": flow.flow, "tag": tag})
            run = send_once(
                SERVICE,
                flow.starts,
                flow.patience,
                lambda: str(flow.starts.run_flow(dict(given), label=flow.name[:64], tags=[tag])["run_id"]),
                lambda: _find_now(flow, tag),
            )
        known = sent.keep("sent", {"globus_flow": flow.flow, "globus_run": run})
    return _wait(flow, str(known["globus_run"]))


def _find(flow: GlobusFlow, tag: str) -> str | None:
    return wait_for(SERVICE, flow.patience, lambda: (_find_now(flow, tag),))[0]


def _find_now(flow: GlobusFlow, tag: str) -> str | None:
    latest_first = {"orderby": "start_time DESC"}
    runs = flow.looks.paginated.list_runs(filter_flow_id=flow.flow, query_params=latest_first).items()
    for number, run in enumerate(runs):
        if tag in (run.get("tags") or ()):
            return str(run["run_id"])
        if number >= MOST_RUNS:
            break
    return None


def _wait(flow: GlobusFlow, run: str) -> GlobusRun:
    def look() -> dict[str, Any] | None:
        found: dict[str, Any] = flow.looks.get_run(run).data
        return None if found["status"] == "ACTIVE" else found

    ended = wait_for(SERVICE, flow.patience, look)
    details = ended.get("details") or {}
    if ended["status"] not in ENDS:
        raise GlobusRefused(
            f"The run {run} of {flow.name} has stopped ({ended['status']}): {_describe_failure(details)}.",
            remedy="Check and resume it in Globus; then start the program again.",
        )
    states = [
        {"state": str(entry["details"]["state_name"]), "code": str(entry["code"]), "time": str(entry["time"])}
        for entry in ask(SERVICE, lambda: list(flow.looks.paginated.get_run_logs(run).items()))
        if "state_name" in (entry.get("details") or {})
    ]
    if ended["status"] == "SUCCEEDED":
        return GlobusRun(run, ended["status"], states, details.get("output"))
    return GlobusRun(run, ended["status"], states, why=_describe_failure(details))


def _describe_failure(details: Mapping[str, Any]) -> str:
    return (
        f"{details.get('code', '')}: {details.get('description', '')}".strip(": ")[:300] or "without a reason"
    )
