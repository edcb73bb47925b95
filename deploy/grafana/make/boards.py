"""All dashboards."""

from __future__ import annotations

from pathlib import Path

from deploy.grafana.make.bench import MODULES, WORKCELL
from deploy.grafana.make.inside import AUDIT, KERNEL_AND_BUS
from deploy.grafana.make.lab import OVERVIEW, UNATTENDED
from deploy.grafana.make.log import POSTGRES, SQLITE, audit_rows, with_log, work_rows
from deploy.grafana.make.work import SCHEDULING, USERS

FOLDER = Path(__file__).parents[1] / "dashboards"
BOARDS = (
    *(OVERVIEW, WORKCELL, MODULES, UNATTENDED, SCHEDULING, KERNEL_AND_BUS),
    *(with_log(USERS, work_rows, source) for source in (POSTGRES, SQLITE)),
    *(with_log(AUDIT, audit_rows, source) for source in (POSTGRES, SQLITE)),
)
