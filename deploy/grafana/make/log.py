"""Tables that are asked of the log itself, in SQL: who did what, campaigns, runs.

A variable of Grafana offers the data sources of one plug-in, and the plug-ins for PostgreSQL and SQLite take
queries in different keys. So each of these dashboards is made twice, from the same SQL.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec
from grafana_foundation_sdk.builders import dashboard
from grafana_foundation_sdk.builders import table as tables
from grafana_foundation_sdk.cog.builder import Builder
from grafana_foundation_sdk.cog.runtime import UnknownDataquery
from grafana_foundation_sdk.models import dashboard as m
from msgspec.structs import replace

from deploy.grafana.make.parts import Board, Panel

VARIABLE = "log"
"""The dashboard's variable that says which log is asked."""

MOMENTS = ("at", "last_at", "asked_at", "resolved_at", "submitted_at", "started_at", "ended_at", "deadline")
"""Columns that are times: SQLite has only text for them, and its plug-in has to be told."""

_SHOWN = "{} BETWEEN $__from / 1000.0 AND $__to / 1000.0"


class Source(msgspec.Struct, frozen=True):
    """A kind of data source: Grafana's plug-in, the uid and name of ours, what uids of dashboards end in, and
    what their titles say."""

    plugin: str
    uid: str
    name: str
    ending: str = ""
    says: str = ""


POSTGRES = Source("grafana-postgresql-datasource", "labos-postgres", "LabOS log (PostgreSQL)")
SQLITE = Source("frser-sqlite-datasource", "labos-sqlite", "LabOS log (SQLite)", "-sqlite", " (SQLite)")

Rows = tuple[tuple[str, tuple[Panel, ...]], ...]


def with_log(board: Board, rows: Callable[[Source], Rows], source: Source) -> Board:
    """A dashboard with further rows of panels, which ask the log."""
    return replace(
        board,
        uid=f"{board.uid}{source.ending}",
        title=f"{board.title}{source.says}",
        extra=(*board.extra, lambda: _variable(source)),
        rows=(*board.rows, *rows(source)),
    )


def _variable(source: Source) -> Builder[m.VariableModel]:
    ours = m.VariableOption(selected=True, text=source.name, value=source.uid)
    return dashboard.DatasourceVariable(VARIABLE).label("Log").type(source.plugin).current(ours)


class _Asked(Builder[Any]):
    """A query in the keys of its data source; the types of Grafana's SDK have none for SQL."""

    def __init__(self, source: Source, sql: str) -> None:
        asked: dict[str, Any] = {
            "refId": "A",
            "datasource": {"type": source.plugin, "uid": f"${{{VARIABLE}}}"},
        }
        if source is SQLITE:
            sql = sql.replace("labos.", "")  # its file has no schemas
            asked |= {"rawQueryText": sql, "queryText": sql, "queryType": "table"}
            asked["timeColumns"] = list(MOMENTS)
        else:
            asked |= {"rawSql": sql, "rawQuery": True, "format": "table", "editorMode": "code"}
        self._asked = asked

    def build(self) -> UnknownDataquery:
        return UnknownDataquery(self._asked)


def table(source: Source, title: str, about: str, sql: Sequence[str], *, width: int = 24) -> Panel:
    """What a query gives, row by row; ``run`` leads to the run, ``done`` is a share."""
    made = tables.Panel().title(title).description(about).filterable(True)
    made = made.datasource(m.DataSourceRef(type_val=source.plugin, uid=f"${{{VARIABLE}}}"))
    made = made.with_target(_Asked(source, " ".join(sql)))
    run = {"title": "the run", "url": "${url}/api/v1/runs/${__value.raw}", "targetBlank": True}
    made = made.override_by_name("run", [m.DynamicConfigValue("links", [run])])
    share = [("unit", "percentunit"), ("min", 0), ("max", 1), ("custom.cellOptions", {"type": "gauge"})]
    made = made.override_by_name("done", [m.DynamicConfigValue(name, value) for name, value in share])
    return Panel(made, width, 10)


def _last_runs(source: Source) -> Panel:
    return table(
        source,
        "Last runs",
        "The hundred that were submitted last, whenever that was; a run leads to what the lab says of it.",
        (
            "SELECT run, workflow, user_id, campaign, row, experiment, status, steps_done, steps,",
            "submitted_at, started_at, ended_at, why",
            "FROM labos.runs ORDER BY submitted_position DESC LIMIT 100",
        ),
    )


def audit_rows(source: Source) -> Rows:
    """Who did what, as the log has it."""
    acts = table(
        source,
        "Who did what lately",
        "The last two hundred events that people caused, in the time shown.",
        (
            "SELECT at, actor, type, run, module, labware, position FROM labos.events",
            "WHERE actor <> 'labos' AND actor NOT LIKE '%/%' AND",
            _SHOWN.format("at_s"),
            "ORDER BY position DESC LIMIT 200",
        ),
        width=12,
    )
    counts = table(
        source,
        "Events by type and actor",
        "In the time shown, the most frequent first.",
        (
            "SELECT type, actor, count(*) AS events, max(at) AS last_at FROM labos.events",
            f"WHERE {_SHOWN.format('at_s')}",
            "GROUP BY type, actor ORDER BY count(*) DESC, type, actor LIMIT 200",
        ),
        width=12,
    )
    questions = table(
        source,
        "Questions, and who answered them",
        "Those that are open, and those that were asked in the time shown; the note says why.",
        (
            "SELECT asked_at, intervention, kind, text, run, module, resolved_at, resolved_by, choice, note",
            f"FROM labos.interventions WHERE resolved_at_s IS NULL OR {_SHOWN.format('asked_at_s')}",
            "ORDER BY asked_position DESC LIMIT 100",
        ),
    )
    return (("As the log has it", (acts, counts, questions, _last_runs(source))),)


def work_rows(source: Source) -> Rows:
    """Campaigns and runs, as the log has them."""
    campaigns = table(
        source,
        "Campaigns",
        "Those that have not ended, then the others, the youngest first; done is the share of its rows.",
        (
            "SELECT campaign, name, user_id, workflow, status,",
            "CAST(completed + failed + cancelled + refused AS double precision) / rows AS done,",
            "rows, completed, failed, cancelled, refused, priority, deadline, submitted_at, ended_at, why",
            "FROM labos.campaigns",
            "ORDER BY CASE WHEN ended_at_s IS NULL THEN 0 ELSE 1 END, submitted_position DESC LIMIT 100",
        ),
    )
    return (("As the log has it", (campaigns, _last_runs(source))),)
