"""Calibrations as rows, and the calibrations that were valid for an action."""

from __future__ import annotations

from labos.audit._bench_tables import CALIBRATIONS
from labos.audit._rows import RowChanges
from labos.core.days import end_of
from labos.core.envelope import Envelope
from labos.core.modules import ModuleCalibrated

IN_FORCE = (
    "c.module = a.module AND c.position < a.requested_position "
    "AND (c.ends_at_s IS NULL OR a.requested_at_s < c.ends_at_s) "
    "AND NOT EXISTS (SELECT 1 FROM calibrations later WHERE later.module = c.module AND later.what = c.what "
    "AND later.position > c.position AND later.position < a.requested_position)"
)
"""An SQL condition: a calibration ``c`` was recorded before the request of an action ``a``, was then the last
one of its kind, and had not expired."""


def on_calibrated(rows: RowChanges, event: ModuleCalibrated, head: Envelope, at: float) -> None:
    rows.put(
        CALIBRATIONS,
        event,
        calibration=f"{event.module}@{head.position}",
        position=head.position,
        recorded_by=event.by,
        at_s=at,
        ends_at_s=float(end_of(event.until)) if event.until else None,
    )
