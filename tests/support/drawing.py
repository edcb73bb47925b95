"""Draws a dashboard as SVG from what its queries give: what it holds, not how Grafana shows it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from xml.sax.saxutils import escape

import msgspec

from tests.support.dashboards import Target, targets

COLUMN, ROW, GAP = 46, 26, 4
COLOURS = ("#3274d9", "#e0752d", "#299c46", "#c15c17", "#a352cc", "#b7950b", "#0f8b8d", "#d44a3a", "#6d6e71")
SHOWN = 8
"""So many series a panel names; curves above that are drawn and not named."""


class Series(msgspec.Struct, frozen=True):
    """A series with its name, as (UNIX time, value)."""

    name: str
    points: tuple[tuple[float, float], ...]

    @property
    def last(self) -> float:
        return self.points[-1][1]


Ask = Callable[[Target], list[dict[str, Any]]]
"""What Prometheus gives for a query of a panel."""


def read(target: Target, found: list[dict[str, Any]]) -> list[Series]:
    """The series of an answer, as the panel calls them; those without any number are left out."""
    series = []
    for one in found:
        pairs = one["values"] if "values" in one else [one["value"]]
        points = tuple((float(at), float(value)) for at, value in pairs if math.isfinite(float(value)))
        if points:
            series.append(Series(_name(target.legend, one["metric"]), points))
    return series


def _name(legend: str, labels: dict[str, str]) -> str:
    if legend == "__auto":
        return ", ".join(labels.values())
    return re.sub(r"\{\{(\w+)\}\}", lambda found: labels.get(found[1], ""), legend)


def draw(board: dict[str, Any], ask: Ask) -> str:
    """The picture of a dashboard."""
    asked = list(targets(board))
    body: list[str] = []
    height = 0
    for panel in board["panels"]:
        place = panel["gridPos"]
        x, y = place["x"] * COLUMN + GAP, place["y"] * ROW + 40 + GAP
        width, tall = place["w"] * COLUMN - 2 * GAP, place["h"] * ROW - 2 * GAP
        height = max(height, y + tall)
        if panel["type"] == "row":
            body.append(_text(x, y + 16, panel["title"], size=14, weight="bold"))
            continue
        if panel["type"] == "table":
            body.append(_text(x, y + 16, f"{panel['title']}: a table that is asked of the log", size=12))
            continue
        mine = [t for t in asked if t.panel == panel["title"] and t.kind == panel["type"]]
        mine = [t for t in mine if any(t.expr == other["expr"] for other in panel["targets"])]
        series = [one for target in mine for one in read(target, ask(target))]
        body.append(f'<rect x="{x}" y="{y}" width="{width}" height="{tall}" fill="#fff" stroke="#d8d9da"/>')
        body.append(_text(x + 8, y + 16, panel["title"], size=12, weight="bold"))
        area = (x + 8, y + 26, width - 16, tall - 34)
        body += PAINTERS[panel["type"]](series, mine[0].unit, area)
    whole = 24 * COLUMN
    head = _text(GAP, 26, board["title"], size=20, weight="bold")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole} {height + GAP}" '
        f'width="{whole}" height="{height + GAP}" font-family="DejaVu Sans, Arial, sans-serif">\n'
        f'<rect width="100%" height="100%" fill="#f4f5f5"/>\n' + "\n".join([head, *body]) + "\n</svg>\n"
    )


Area = tuple[float, float, float, float]


def _number(series: Sequence[Series], unit: str, area: Area) -> Iterator[str]:
    x, y, width, height = area
    value = show_value(series[0].last, unit) if series else "no data"
    yield _text(x + width / 2, y + height / 2 + 12, value, size=26, anchor="middle", fill="#299c46")


def _curves(series: Sequence[Series], unit: str, area: Area) -> Iterator[str]:
    x, y, width, height = area
    height -= 22  # for the names
    if not series:
        return
    times = [at for one in series for at, _ in one.points]
    top = max((value for one in series for _, value in one.points), default=0.0) or 1.0
    begin, end = min(times), max(max(times), min(times) + 1)
    left = x + 56
    for share in (0.0, 0.5, 1.0):
        line = y + height - share * (height - 6)
        yield f'<path d="M{left:.0f} {line:.1f}H{x + width:.0f}" stroke="#e4e5e6"/>'
        yield _text(left - 4, line + 4, show_value(share * top, unit), size=10, anchor="end", fill="#6d6e71")
    for number, one in enumerate(series):
        steps = (
            f"{left + (at - begin) / (end - begin) * (x + width - left):.1f} "
            f"{y + height - max(value, 0.0) / top * (height - 6):.1f}"
            for at, value in one.points
        )
        colour = COLOURS[number % len(COLOURS)]
        yield f'<path d="M{" L".join(steps)}" fill="none" stroke="{colour}" stroke-width="1.5"/>'
    yield from _names(series, (left, y + height + 16, x + width))


def _names(series: Sequence[Series], line: tuple[float, float, float]) -> Iterator[str]:
    x, y, end = line
    for number, one in enumerate(series[:SHOWN]):
        if x + 7 * len(one.name) > end:
            yield _text(x, y, f"and {len(series) - number} more", size=10, fill="#6d6e71")
            return
        yield _box(x, y - 8, 10, 4, COLOURS[number % len(COLOURS)])
        yield _text(x + 13, y, one.name, size=10, fill="#333")
        x += 22 + 6.4 * len(one.name)


def _bars(series: Sequence[Series], unit: str, area: Area) -> Iterator[str]:
    x, y, width, height = area
    kept = list(series)[: max(int(height // 16), 1)]
    top = max((one.last for one in kept), default=0.0) or 1.0
    left = x + width * 0.36
    for number, one in enumerate(kept):
        line = y + number * 16
        long = max(one.last, 0.0) / top * (x + width - left - 60)
        yield _text(left - 6, line + 11, one.name, size=10, anchor="end", fill="#333")
        yield _box(left, line + 2, long, 11, COLOURS[0])
        yield _text(left + long + 4, line + 11, show_value(one.last, unit), size=10, fill="#333")


def _strips(series: Sequence[Series], unit: str, area: Area) -> Iterator[str]:
    x, y, width, height = area
    if not series:
        return
    times = [at for one in series for at, _ in one.points]
    begin, end = min(times), max(max(times), min(times) + 1)
    tall = min(height / len(series), 22)
    left = x + 120
    for number, one in enumerate(series):
        line = y + number * tall
        yield _text(
            left - 6, line + tall / 2 + 4, one.name, size=min(10, tall - 1), anchor="end", fill="#333"
        )
        yield _box(left, line + 1, x + width - left, tall - 2, "#e4e5e6")
        for (at, value), (until, _) in zip(one.points, [*one.points[1:], (end, 0.0)], strict=True):
            if value > 0:
                a = left + (at - begin) / (end - begin) * (x + width - left)
                b = left + (until - begin) / (end - begin) * (x + width - left)
                yield _box(a, line + 1, max(b - a, 0.5), tall - 2, COLOURS[0])


PAINTERS: dict[str, Callable[[Sequence[Series], str, Area], Iterator[str]]] = {
    "stat": _number,
    "timeseries": _curves,
    "bargauge": _bars,
    "state-timeline": _strips,
}


def show_value(value: float, unit: str) -> str:
    """A value with its unit, short."""
    if unit == "percentunit":
        return f"{value * 100:.3g} %"
    if unit == "s":
        for size, name in ((86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms")):
            if abs(value) >= size:
                return f"{value / size:.3g} {name}"
        return f"{value * 1e6:.3g} µs" if value else "0 s"
    if unit == "bytes":
        for size, name in ((2.0**30, "GiB"), (2.0**20, "MiB"), (2.0**10, "KiB")):
            if abs(value) >= size:
                return f"{value / size:.3g} {name}"
    return f"{value:.3g}" if abs(value) < 1000 or value != round(value) else f"{value:.0f}"


def _box(x: float, y: float, width: float, height: float, fill: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{fill}"/>'


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: float,
    weight: str = "normal",
    anchor: str = "start",
    fill: str = "#1f1f20",
) -> str:
    look = f'font-size="{size:g}" font-weight="{weight}" text-anchor="{anchor}" fill="{fill}"'
    return f'<text x="{x:.0f}" y="{y:.0f}" {look}>{escape(text)}</text>'
