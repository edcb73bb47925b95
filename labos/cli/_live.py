"""An overview of the lab for a terminal: runs, why they wait, and where every plate is."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from labos.core.ids import local
from labos.services.times import show_span, show_time

ENDED_SHOWN = 8


def draw_picture(state: dict[str, Any], ended: dict[str, str]) -> Group:
    """``ended`` are the runs that have ended, by id, each in one line."""
    return Group(
        Panel(_runs(state, ended), title="Runs", title_align="left"),
        Panel(_draw_plates(state), title="Plates", title_align="left"),
        _draw_modules(state),
        *(Text(f"{q['id']}: {q['text']}", style="bold red") for q in state["interventions"]),
    )


def _runs(state: dict[str, Any], ended: dict[str, str]) -> Table:
    table = Table.grid(padding=(0, 2))
    for run in list(ended)[-ENDED_SHOWN:]:
        table.add_row(run, "", "", "", f"[green]{escape(ended[run])}")
    for run in state["runs"]:
        doing = ", ".join(_show_step(step) for step in run["doing"])
        waits = "; ".join(dict.fromkeys(wait["why"] for wait in run["waits"]))
        bar = ProgressBar(total=run["steps"], completed=run["done"], width=16)
        words = escape(doing) if doing else f"[yellow]waits: {escape(waits or 'its turn')}"
        words += _show_due(run)
        table.add_row(run["id"], run["workflow"], run["user"], bar, words)
    return table


def _show_due(run: dict[str, Any]) -> str:
    """A run's due date, in red if the run can no longer keep it."""
    if not run["due_at"]:
        return ""
    late_s = run["late_by_s"]
    late = f"[red], late by at least {show_span(late_s)}[/]" if late_s > 0 else ""
    return f"[dim], due {show_time(run['due_at'])[:16]}[/]{late}"


def _show_step(step: dict[str, Any]) -> str:
    left = f", {show_span(step['left_s'])} left" if step["left_s"] else ""
    return f"{step['key']} ({step['module']}{left})"


def _draw_plates(state: dict[str, Any]) -> Table:
    table = Table.grid(padding=(0, 2))
    for item in state["labware"]:
        place = item["station"] or "perhaps " + " or ".join(item["maybe"])
        moving = " [cyan](in use)" if item["moving"] else ""
        table.add_row(item["id"], item["type"], f"{escape(place)}{moving}", item["owner"] or "nobody's")
    if not state["labware"]:
        table.add_row("[dim]all plates are in the stacks")
    return table


def _draw_modules(state: dict[str, Any]) -> Text:
    text = Text()
    colors = {"IDLE": "dim", "BUSY": "cyan", "ERROR": "bold red", "GONE": "red"}
    for module in state["modules"]:
        name = local(module["module"])
        text.append(f"{name} ", style=colors.get(module["status"], ""))
    return text
