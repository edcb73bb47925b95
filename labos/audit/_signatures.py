"""Electronic signatures as rows."""

from __future__ import annotations

from labos.audit._rows import RowChanges
from labos.audit._work_tables import SIGNATURES
from labos.core.envelope import Envelope
from labos.core.signatures import RecordsSigned, RunSigned


def on_signed(rows: RowChanges, event: RunSigned | RecordsSigned, head: Envelope, at: float) -> None:
    run = {"subject": event.run, "kind": "run", "runs": 0} if isinstance(event, RunSigned) else {}
    about = {"position": head.position, "signed_by": event.by, "comment": event.why, "at_s": at}
    rows.put(SIGNATURES, event, **about, **run)
