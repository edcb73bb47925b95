"""What dashboards are put together from: panels in rows, variables, annotations, links.

A panel asks one data source. Those on Prometheus are made here; one that asks another is the same ``Panel``
with other targets.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
from grafana_foundation_sdk.builders import (
    bargauge,
    common,
    dashboard,
    prometheus,
    stat,
    statetimeline,
    timeseries,
)
from grafana_foundation_sdk.cog.builder import Builder
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models import common as c
from grafana_foundation_sdk.models import dashboard as m

PROMETHEUS = m.DataSourceRef(type_val="prometheus", uid="labos-prometheus")
WIDTH = 24
TAG = "labos"

LAB = 'lab="$lab"'
CELL = f'{LAB},workcell=~"$workcell"'
MODULE = f'{CELL},module=~"$module"'
USER = f'{LAB},user=~"$user"'
KERNEL = f'{LAB},process="kernel"'
NODE = f'{MODULE},process="node"'

Query = tuple[str, str]
"""A PromQL expression, and how its series are called (``{{label}}``)."""

Look = Callable[[Any], Any]


class Panel(msgspec.Struct, frozen=True):
    """A panel before it has its place: its builder, how many of the 24 columns it takes, how high it is."""

    made: Any
    width: int
    height: int


class Board(msgspec.Struct, frozen=True):
    """A dashboard: ``rows`` of panels, each with its title. ``variables`` are names of ``VARIABLES``;
    ``extra`` make further ones."""

    uid: str
    title: str
    about: str
    variables: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Panel, ...]], ...]
    extra: tuple[Callable[[], Any], ...] = ()


# -- panels ------------------------------------------------------------------------------------


def _dressed(made: Any, title: str, about: str, queries: Sequence[Query], unit: str, *, instant: bool) -> Any:
    made = made.title(title).description(about).datasource(PROMETHEUS).unit(unit)
    for number, (expr, legend) in enumerate(queries):
        target = prometheus.Dataquery().expr(expr).legend_format(legend or "__auto")
        target = target.ref_id(chr(ord("A") + number)).datasource(PROMETHEUS)
        made = made.with_target(target.instant() if instant else target.range())
    return made


def number(
    title: str,
    about: str,
    expr: str,
    *,
    unit: str = "short",
    width: int = 4,
    warn: float | None = None,
    less: bool = False,
) -> Panel:
    """One number now. Above ``warn`` (``less``: below it) it is red."""
    made = _dressed(stat.Panel(), title, about, [(expr, title)], unit, instant=True)
    made = made.graph_mode(c.BigValueGraphMode.NONE).reduce_options(
        common.ReduceDataOptions().calcs(["lastNotNull"])
    )
    good, bad = ("red", "green") if less else ("green", "red")
    steps = [m.Threshold(value=None, color=good)]
    if warn is not None:
        steps.append(m.Threshold(value=warn, color=bad))
    elif less:
        steps = [m.Threshold(value=None, color="green")]
    made = made.thresholds(dashboard.ThresholdsConfig().mode(m.ThresholdsMode.ABSOLUTE).steps(steps))
    return Panel(made, width, 4)


def lines(
    title: str, about: str, *queries: Query, unit: str = "short", width: int = 12, stacked: bool = False
) -> Panel:
    """Curves over time."""
    made = _dressed(timeseries.Panel(), title, about, queries, unit, instant=False)
    made = made.line_width(1).fill_opacity(25 if stacked else 8).show_points(c.VisibilityMode.NEVER)
    if stacked:
        made = made.stacking(common.StackingConfig().mode(c.StackingMode.NORMAL))
    legend = common.VizLegendOptions().display_mode(c.LegendDisplayMode.LIST)
    made = made.legend(legend.placement(c.LegendPlacement.BOTTOM).show_legend(True))
    return Panel(made.min(0), width, 8)


def bars(
    title: str, about: str, *queries: Query, unit: str = "short", width: int = 12, most: float | None = None
) -> Panel:
    """One bar for each series, as it is now."""
    made = _dressed(bargauge.Panel(), title, about, queries, unit, instant=True)
    made = made.orientation(c.VizOrientation.HORIZONTAL).display_mode(c.BarGaugeDisplayMode.BASIC)
    made = made.reduce_options(common.ReduceDataOptions().calcs(["lastNotNull"])).min(0)
    return Panel(made if most is None else made.max(most), width, 8)


def states(title: str, about: str, *queries: Query, width: int = 24) -> Panel:
    """A strip for each series: dark where it is 1."""
    made = _dressed(statetimeline.Panel(), title, about, queries, "short", instant=False)
    return Panel(
        made.show_value(c.VisibilityMode.NEVER).row_height(0.8).fill_opacity(70).line_width(0), width, 9
    )


# -- the whole ---------------------------------------------------------------------------------


def _variable(name: str, label: str, query: str, *, many: bool = True) -> Builder[m.VariableModel]:
    made = (
        dashboard.QueryVariable(name)
        .label(label)
        .datasource(PROMETHEUS)
        .query({"query": query, "refId": name})
    )
    made = made.refresh(m.VariableRefresh.ON_TIME_RANGE_CHANGED).sort(m.VariableSort.ALPHABETICAL_ASC)
    if not many:
        return made
    everything = m.VariableOption(selected=True, text="All", value="$__all")
    return made.multi(True).include_all(True).all_value(".*").current(everything)


VARIABLES: dict[str, Callable[[], Builder[m.VariableModel]]] = {
    "lab": lambda: _variable("lab", "Lab", "label_values(labos_lab_info, lab)", many=False),
    "workcell": lambda: _variable(
        "workcell", "Workcell", f"label_values(labos_queue_runs{{{LAB}}}, workcell)"
    ),
    "module": lambda: _variable("module", "Module", f"label_values(labos_module_state{{{CELL}}}, module)"),
    "user": lambda: _variable(
        "user", "User", f"label_values(labos_user_module_seconds_total{{{LAB}}}, user)"
    ),
    "url": lambda: (
        dashboard.TextBoxVariable("url").label("Address of the lab").default_value("http://127.0.0.1:8000")
    ),
}


def _marked(name: str, expr: str, colour: str) -> Builder[m.AnnotationQuery]:
    made = dashboard.AnnotationQuery().name(name).datasource(PROMETHEUS).enable(True)
    return made.icon_color(colour).expr(expr)


def _since(kind: str) -> str:
    return f'increase(labos_events_total{{{LAB},type="{kind}"}}[$__rate_interval]) > 0'


ANNOTATIONS: tuple[Callable[[], Builder[m.AnnotationQuery]], ...] = (
    lambda: _marked("Questions for a person", _since("intervention.requested"), "orange"),
    lambda: _marked("Emergency stops", _since("module.emergency_stopped"), "red"),
    lambda: _marked("Kernel starts", f"changes(labos_kernel_epoch{{{LAB}}}[$__rate_interval]) > 0", "blue"),
)


def build(board: Board) -> m.Dashboard:
    """The dashboard: panels from left to right in rows of 24 columns, ids in the order of reading."""
    made = dashboard.Dashboard(board.title).uid(board.uid).description(board.about).tags([TAG])
    made = made.time("now-6h", "now").refresh("30s").timezone("browser").editable()
    made = made.tooltip(m.DashboardCursorSync.CROSSHAIR)
    for name in (*board.variables, "url"):
        made = made.with_variable(VARIABLES[name]())
    for variable in board.extra:
        made = made.with_variable(variable())
    for annotation in ANNOTATIONS:
        made = made.annotation(annotation())
    others = dashboard.DashboardLink("LabOS").type(m.DashboardLinkType.DASHBOARDS).tags([TAG])
    made = made.link(others.as_dropdown(True).include_vars(True).keep_time(True))
    runs = dashboard.DashboardLink("Runs").type(m.DashboardLinkType.LINK).url("${url}/api/v1/runs?ended=50")
    made = made.link(runs.target_blank(True))
    y, ids = 0, iter(range(1, 1000))
    panels: list[Any] = []
    for title, row in board.rows:
        panels.append(_row(title, next(ids), y))
        y, x, tallest = y + 1, 0, 0
        for panel in row:
            if x + panel.width > WIDTH:
                x, y, tallest = 0, y + tallest, 0
            place = m.GridPos(h=panel.height, w=panel.width, x=x, y=y)
            panels.append(panel.made.id(next(ids)).grid_pos(place).build())
            x, tallest = x + panel.width, max(tallest, panel.height)
        y += tallest
    found = made.build()
    found.panels = panels
    return found


def _row(title: str, number: int, y: int) -> m.RowPanel:
    return dashboard.Row(title).id(number).grid_pos(m.GridPos(h=1, w=WIDTH, x=0, y=y)).build()


def text_of(board: Board) -> str:
    """The dashboard's file, as Grafana reads it."""
    return json.dumps(build(board), cls=JSONEncoder, sort_keys=True, indent=1, ensure_ascii=False) + "\n"
