"""Whether runs will end by their due dates, in words."""

from __future__ import annotations

from collections.abc import Iterable

from labos.core.state import LabState, encode_picture
from labos.planning.hindsight import TimeRange
from labos.planning.lab_forecast import ForecastRequest, forecast_lab
from labos.planning.own_order import OwnOrder
from labos.services.runs import RunHistory
from labos.services.times import show_time

MOST_STEPS = 5_000
"""At most so many steps are simulated; beyond them there is no forecast."""


def describe_due(
    state: LabState, stories: Iterable[RunHistory], now: int, *, searches: bool = False
) -> dict[str, str]:
    """For each of these runs with a due date: the due date, and whether the run kept it or, if the run has
    not ended, will keep it. For this the lab is simulated in virtual time, without rows that campaigns have
    not submitted. ``searches``: the lab looks for orders of its own."""
    dated = [story for story in stories if story.due_at]
    alive = {story.id for story in dated if not story.over}
    found = {story.id: _describe_past(story) for story in dated if story.over}
    if not alive:
        return found
    orders: dict[str, OwnOrder] | None = {} if searches else None
    request = ForecastRequest(encode_picture(state), now, most_steps=MOST_STEPS, orders=orders)
    forecast = forecast_lab(request)
    ends = {run.run: run.ends for run in forecast.runs}
    for story in dated:
        if story.id in alive:
            kept = describe_margin(story.due_at, ends.get(story.id))
            found[story.id] = f"{show_time(story.due_at)}: {kept}"
    return found


def _describe_past(story: RunHistory) -> str:
    if story.status != "completed":
        return show_time(story.due_at)
    late = story.ended_at > story.due_at
    return f"{show_time(story.due_at)}: {'was late' if late else 'was kept'}"


def describe_margin(due_at: int, ends: TimeRange | None) -> str:
    """Whether a run will end by its due date, according to a forecast of its end (None: beyond the
    forecast)."""
    if ends is None:
        return "its end cannot be estimated"
    late_s = (ends.expected_at - due_at) / 1e9
    if late_s >= 1:
        return f"late by about {_show_about(late_s)}"
    if ends.latest_at > due_at:
        return f"may be late, by up to {_show_about((ends.latest_at - due_at) / 1e9)}"
    return f"kept, with about {_show_about(-late_s)} to spare"


def _show_about(seconds: float) -> str:
    if seconds < 60:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
