"""Approvals as rows: the person, the submission and its digest, the time, and the comment; and electronic
signatures as rows."""

from __future__ import annotations

import msgspec

from labos.audit._campaigns import set_terms
from labos.audit._rows import Row, RowChanges
from labos.audit._work_tables import APPROVALS, CAMPAIGNS, EXPERIMENTS, RUNS, SIGNATURES, WAITING
from labos.core import approvals as p
from labos.core.envelope import Envelope
from labos.core.signatures import RecordsSigned, RunSigned


def on_requested(rows: RowChanges, event: p.ApprovalRequested, head: Envelope, at: float) -> None:
    _answer(rows, event.subject, "changed", "", "", head, at)
    rows.put(WAITING, subject=event.subject, position=head.position)
    rows.put(
        APPROVALS,
        event,
        requested_position=head.position,
        user_id=event.user,
        asked_by=event.by,
        why=[why.text for why in event.why],
        changed=list(event.changed),
        requested_at_s=at,
    )
    if event.kind == "campaign":
        rows.update(CAMPAIGNS, event.subject, status="proposed")


def on_given(rows: RowChanges, event: p.ApprovalGiven, head: Envelope, at: float) -> None:
    row = _answer(rows, event.subject, "approved", event.by, event.comment, head, at)
    changes = {"priority": event.priority, "terms": msgspec.to_builtins(event.terms), "alike": event.alike}
    if row is not None:
        row["changes"] = {name: value for name, value in changes.items() if value} or None
    table = {"run": RUNS, "experiment": EXPERIMENTS}.get(event.kind)
    if table is not None and event.priority is not None:
        rows.update(table, event.subject, priority=event.priority)
    if event.kind == "campaign":
        campaign = rows.update(CAMPAIGNS, event.subject, status="open")
        if event.terms is not None:
            set_terms(campaign, event.terms)


def on_refused(rows: RowChanges, event: p.ApprovalRefused, head: Envelope, at: float) -> None:
    _answer(rows, event.subject, "refused", event.by, event.comment, head, at)


def on_second_person(rows: RowChanges, event: p.RunApproved, head: Envelope, at: float) -> None:
    """Handle a run that needs only the approval of a second person."""
    run = rows.get(RUNS, event.run)
    rows.put(
        APPROVALS,
        requested_position=head.position,
        subject=event.run,
        kind="second person",
        name=run["workflow"],
        user_id=run["user_id"],
        digest=run["plan"],
        why=["it has dangerous steps"],
        parts={},
        changed=[],
        requested_at_s=at,
        answer="approved",
        answered_by=event.by,
        answered_at_s=at,
        answered_position=head.position,
    )


def on_signed(rows: RowChanges, event: RunSigned | RecordsSigned, head: Envelope, at: float) -> None:
    run = {"subject": event.run, "kind": "run", "runs": 0} if isinstance(event, RunSigned) else {}
    about = {"position": head.position, "signed_by": event.by, "comment": event.why, "at_s": at}
    rows.put(SIGNATURES, event, **about, **run)


def _answer(
    rows: RowChanges, subject: str, answer: str, by: str, comment: str, head: Envelope, at: float
) -> Row | None:
    """The row of a waiting submission, with its answer; None if none waits."""
    row = rows.change(APPROVALS, rows.get(WAITING, subject)["position"])
    if not row["subject"] or row["answer"]:
        return None
    row["answer"], row["answered_by"], row["comment"] = answer, by, comment
    row["answered_at_s"], row["answered_position"] = at, head.position
    return row
