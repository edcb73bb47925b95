"""Metrics that stay fast with many series: a line is made when its value changes, and the lines are joined
for a scrape.

A lab of a thousand modules has tens of thousands of series, and few of them change between two scrapes. Each
line of the answer is stored as text and made again only when its value has changed. Everything else comes
from ``prometheus_client``: its exposition and its servers accept a registry of this module.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

from prometheus_client import Metric

Labels = tuple[str, ...]
Kind = Literal["counter", "gauge", "histogram", "summary"]

OTHER = "other"
"""The label for all sets of labels above the limit."""

MOST = 1000
"""The default limit of sets of labels of a metric."""


ACTION_BOUNDS_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0)
"""The bounds for distributions of the duration of actions: from a tenth of a second to an hour."""


class BoundedNames:
    """Names from outside as labels: the first ``most`` names keep their labels as long as the process runs;
    all later ones share one."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: dict[str, bool] = {}

    def __call__(self, name: str) -> str:
        if name not in self._known:
            if len(self._known) >= self._most:
                return OTHER
            self._known[name] = True
        return name


class LabMetric:
    """All series of one metric. ``most`` limits the number of sets of labels; later ones share a set whose
    labels are all ``other``."""

    kind: Kind

    def __init__(self, name: str, help: str, labels: Labels = (), *, most: int = MOST) -> None:
        self.name, self.help, self.labels, self.most = name, help, labels, most
        self._prefixes: dict[Labels, str] = {}
        self._changed: dict[Labels, bool] = {}
        self._lines: dict[Labels, str] = {}
        self._rest = (OTHER,) * len(labels)

    @property
    def width(self) -> int:
        """The number of series for one set of labels."""
        return 1

    def lines(self) -> Iterable[str]:
        """The series in Prometheus' text format, without their head."""
        for key in self._changed:
            self._lines[key] = self._write(key)
        self._changed.clear()
        return self._lines.values()

    def samples(self) -> Iterator[tuple[str, dict[str, str], float]]:
        """(name, labels, value) of each series."""
        for key in self._prefixes:
            named = dict(zip(self.labels, key, strict=True))
            for name, more, value in self._list_points(key):
                yield name, {**named, **more}, value

    def _list_points(self, key: Labels) -> Iterable[tuple[str, dict[str, str], float]]:
        """(name, further labels, value) of each series of one set of labels."""
        raise NotImplementedError

    def _write(self, key: Labels) -> str:
        prefix = self._prefixes[key]
        return "\n".join(
            _line(name, _join_labels(prefix, f'le="{more["le"]}"') if more else prefix, value)
            for name, more, value in self._list_points(key)
        )

    def _labels_of(self, key: Labels) -> Labels:
        """The set of labels under which a value is stored; the prefix of a new set is made here."""
        if key in self._prefixes:
            return key
        if len(self._prefixes) >= self.most and self.labels:
            key = self._rest
        if key not in self._prefixes:
            self._prefixes[key] = ",".join(
                f'{name}="{_escape(value)}"' for name, value in zip(self.labels, key, strict=True)
            )
        return key


class _NumberMetric(LabMetric):
    """A metric with one number for each set of labels."""

    def __init__(self, name: str, help: str, labels: Labels = (), *, most: int = MOST) -> None:
        super().__init__(name, help, labels, most=most)
        self._values: dict[Labels, float] = {}

    def _list_points(self, key: Labels) -> Iterable[tuple[str, dict[str, str], float]]:
        return ((self.name, {}, self._values[key]),)

    def _write(self, key: Labels) -> str:
        """The same without a detour: most series are numbers."""
        return _line(self.name, self._prefixes[key], self._values[key])


class CounterMetric(_NumberMetric):
    """A counter only increases, except at a new start of the process."""

    kind: Kind = "counter"

    def __init__(self, name: str, help: str, labels: Labels = (), *, most: int = MOST) -> None:
        super().__init__(name, help, labels, most=most)
        if not labels:
            self.begin()

    def begin(self, key: Labels = ()) -> None:
        """Create the series with 0, because a query for its increase needs a first value."""
        self.add(key, 0.0)

    def add(self, key: Labels = (), by: float = 1.0) -> None:
        if key not in self._values:
            key = self._labels_of(key)
        self._values[key] = self._values.get(key, 0.0) + by
        self._changed[key] = True

    def value(self, key: Labels = ()) -> float:
        return self._values.get(key, 0.0)


class GaugeMetric(_NumberMetric):
    """A present value. ``replace`` sets all series; those that it does not name are removed."""

    kind: Kind = "gauge"

    def set(self, value: float, key: Labels = ()) -> None:
        if self._values.get(key) != value:
            key = self._labels_of(key)
            self._values[key] = value
            self._changed[key] = True

    def replace(self, values: Mapping[Labels, float]) -> None:
        for key in self._values.keys() - values.keys():
            del self._values[key], self._prefixes[key]
            self._changed.pop(key, None)
            self._lines.pop(key, None)
        rest = 0.0
        for key, value in values.items():
            if self._values.get(key) == value:
                continue
            if key not in self._prefixes and len(self._prefixes) >= self.most:
                rest += value
            else:
                self.set(value, key)
        if rest:
            self.set(rest, self._rest)

    def clear(self) -> None:
        """Remove all series."""
        self.replace({})


class ComputedCounter(GaugeMetric):
    """A gauge in the code and a counter for Prometheus. Its values are computed for each scrape and never
    decrease. Work under way counts up to now, but it may turn out that it ended a moment before. Prometheus
    would interpret the decrease as a new start of the process, with an enormous rate."""

    kind: Kind = "counter"

    def set(self, value: float, key: Labels = ()) -> None:
        super().set(max(value, self._values.get(key, value)), key)

    def replace(self, values: Mapping[Labels, float]) -> None:
        super().replace({key: max(value, self._values.get(key, value)) for key, value in values.items()})


class _Observations:
    """The observations of one series of a distribution."""

    __slots__ = ("counts", "total")

    def __init__(self, buckets: int) -> None:
        self.counts = [0] * (buckets + 1)
        self.total = 0.0


class Distribution(LabMetric):
    """A distribution of values: a histogram with the upper ``bounds``, or, without bounds, only number and
    sum."""

    def __init__(
        self, name: str, help: str, labels: Labels = (), *, bounds: Sequence[float] = (), most: int = MOST
    ) -> None:
        super().__init__(name, help, labels, most=most)
        self.kind = "histogram" if bounds else "summary"
        self.bounds = tuple(bounds)
        self._heaps: dict[Labels, _Observations] = {}
        if not labels:
            self.begin()

    @property
    def width(self) -> int:
        return len(self.bounds) + 3 if self.bounds else 2

    def begin(self, key: Labels = ()) -> None:
        """Create the series without observations."""
        key = self._labels_of(key)
        if key not in self._heaps:
            self._heaps[key] = _Observations(len(self.bounds))
            self._changed[key] = True

    def observe(self, value: float, key: Labels = ()) -> None:
        heap = self._heaps.get(key)
        if heap is None:
            self.begin(key)
            key = self._labels_of(key)
            heap = self._heaps[key]
        heap.counts[bisect_left(self.bounds, value)] += 1
        heap.total += value
        self._changed[key] = True

    def _list_points(self, key: Labels) -> Iterable[tuple[str, dict[str, str], float]]:
        counts, total = list(self._heaps[key].counts), self._heaps[key].total
        if self.bounds:
            upto = 0
            for bound, count in zip((*self.bounds, math.inf), counts, strict=True):
                upto += count
                yield f"{self.name}_bucket", {"le": _write_number(bound)}, upto
        yield f"{self.name}_count", {}, sum(counts)
        yield f"{self.name}_sum", {}, total


class MetricGroup:
    """Metrics that belong together: all its attributes that are metrics, in their order."""

    @property
    def families(self) -> list[LabMetric]:
        return [value for value in vars(self).values() if isinstance(value, LabMetric)]

    def show(self, kind: type[GaugeMetric], metrics: Mapping[str, tuple[str, str]]) -> None:
        """Add metrics without labels: name and help, by the name of the reading that ``take`` sets."""
        for reading, (name, help) in metrics.items():
            setattr(self, reading, kind(name, help))

    def take(self, **readings: float | None) -> None:
        """Set the metrics with these names; a metric keeps its value if its reading is None."""
        for name, value in readings.items():
            metric: GaugeMetric = getattr(self, name)
            if value is not None:
                metric.set(value)

    def clear(self) -> None:
        """Remove all series of the gauges."""
        for family in self.families:
            if isinstance(family, GaugeMetric):
                family.clear()


class MetricRegistry:
    """Metrics in the order in which they are shown. ``counts`` is the number of series at the last scrape."""

    def __init__(self, families: Iterable[LabMetric] = ()) -> None:
        self.families: list[LabMetric] = list(families)
        self.counts = 0

    @property
    def most(self) -> int:
        """The largest possible number of series; each metric may have one more set of labels."""
        return sum((family.most + 1 if family.labels else 1) * family.width for family in self.families)

    def text(self) -> str:
        """All metrics in Prometheus' text format, version 0.0.4. A metric without series is left out."""
        parts: list[str] = []
        self.counts = 0
        for family in self.families:
            lines = list(family.lines())
            if lines:
                parts.append(f"# HELP {family.name} {_escape_help(family.help)}")
                parts.append(f"# TYPE {family.name} {family.kind}")
                parts += lines
                self.counts += len(lines) * family.width
        return "\n".join(parts) + "\n" if parts else ""

    def collect(self) -> Iterator[Metric]:
        """The same for ``prometheus_client``: its exposition, its servers and the tests of its parsers."""
        for family in self.families:
            metric = Metric(family.name.removesuffix("_total"), family.help, family.kind)
            for name, labels, value in family.samples():
                metric.add_sample(name, labels, value)
            if metric.samples:
                yield metric


def _line(name: str, labels: str, value: float) -> str:
    return f"{name}{{{labels}}} {_write_number(value)}" if labels else f"{name} {_write_number(value)}"


def _join_labels(labels: str, more: str) -> str:
    return f"{labels},{more}" if labels else more


def _write_number(value: float) -> str:
    if value == math.inf:
        return "+Inf"
    return repr(float(value)) if math.isfinite(value) else "NaN" if math.isnan(value) else "-Inf"


def _escape(value: str) -> str:
    return value.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


def _escape_help(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n")
