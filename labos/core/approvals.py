"""A second person: runs with dangerous steps wait until somebody else than their user has approved them."""

from __future__ import annotations

from labos.core.registry import event
from labos.core.runs import RunEvent, Runs, let_wait_anew


@event("run.approved")
class RunApproved(RunEvent, frozen=True):
    """Its dangerous steps may be carried out: ``by`` is not whose run it is, and has seen what it does."""

    by: str


def approved(runs: Runs, event: RunApproved, at: int) -> None:
    run = runs.queued[event.run]
    with let_wait_anew(runs, run):
        run.unapproved = False


HANDLERS = {RunApproved: approved}
