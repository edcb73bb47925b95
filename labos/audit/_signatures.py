"""Electronic signatures as rows."""

from __future__ import annotations

from labos.audit._rows import RowChanges
from labos.audit._work_tables import SIGNATURES
from labos.core.envelope import Envelope
from labos.core.signatures import RecordsSigned, RunSigned


def on_run_signed(rows: RowChanges, event: RunSigned, head: Envelope, at: float) -> None:
    _add(rows, event, event.run, "run", 0, head, at)


def on_records_signed(rows: RowChanges, event: RecordsSigned, head: Envelope, at: float) -> None:
    _add(rows, event, event.subject, event.kind, event.runs, head, at)


def _add(
    rows: RowChanges,
    event: RunSigned | RecordsSigned,
    subject: str,
    kind: str,
    runs: int,
    head: Envelope,
    at: float,
) -> None:
    rows.put(
        SIGNATURES,
        {
            "position": head.position,
            "subject": subject,
            "kind": kind,
            "signed_by": event.by,
            "comment": event.why,
            "at_s": at,
            "runs": runs,
        },
        event,
    )
