"""The text that is written here is what Prometheus' own library writes and reads."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from labos.telemetry.series import (
    ComputedCounter,
    CounterMetric,
    Distribution,
    GaugeMetric,
    LabMetric,
    MetricRegistry,
)

TEXT = st.text(alphabet=st.characters(exclude_categories=["Cs"], exclude_characters="\r"), max_size=12)
NUMBER = st.floats(allow_nan=False)


def read(text: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """The series of a text by name and labels."""
    found: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            key = (sample.name, tuple(sorted(sample.labels.items())))
            assert key not in found
            found[key] = sample.value
    return found


def as_the_library_writes(*families: LabMetric) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    library = CollectorRegistry()
    library.register(MetricRegistry(families))  # type: ignore[arg-type]
    return read(generate_latest(library).decode())


def both(*families: LabMetric) -> dict[Any, float]:
    """What both write, which is the same."""
    found = read(MetricRegistry(families).text())
    assert found == as_the_library_writes(*families)
    return found


@given(st.dictionaries(st.tuples(TEXT, TEXT), NUMBER, min_size=1, max_size=6))
def test_any_label_and_value_is_written_as_the_library_writes_it(values: dict[Any, float]) -> None:
    gauge = GaugeMetric("labos_x", "Any\ntext, \\ and all.", ("a", "b"))
    gauge.replace(values)
    assert both(gauge) == {("labos_x", (("a", a), ("b", b))): v for (a, b), v in values.items()}


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 1e6)), max_size=30))
def test_a_histogram_holds_what_it_has_seen(seen: list[tuple[str, float]]) -> None:
    histogram = Distribution("labos_x_seconds", "x", ("a",), bounds=(1.0, 10.0))
    for position, (label, value) in enumerate(seen):
        histogram.observe(value, (label,))
        if position % 7 == 0:
            both(histogram)  # a scrape between does not disturb it
    found = both(histogram)
    for label in {label for label, _ in seen}:
        mine = [value for other, value in seen if other == label]
        for bound in (1.0, 10.0, math.inf):
            le = "+Inf" if bound == math.inf else str(bound)
            key = ("labos_x_seconds_bucket", (("a", label), ("le", le)))
            assert found[key] == sum(value <= bound for value in mine)
        assert found["labos_x_seconds_count", (("a", label),)] == len(mine)
        assert math.isclose(found["labos_x_seconds_sum", (("a", label),)], math.fsum(mine), abs_tol=1e-6)


def test_a_counter_goes_on_between_scrapes() -> None:
    counter = CounterMetric("labos_x_total", "x", ("a",))
    counter.begin(("one",))
    assert both(counter) == {("labos_x_total", (("a", "one"),)): 0.0}
    counter.add(("one",))
    counter.add(("two",), 2.5)
    assert both(counter)["labos_x_total", (("a", "two"),)] == 2.5
    counter.add(("one",))
    assert both(counter)["labos_x_total", (("a", "one"),)] == 2.0


def test_what_has_no_room_is_put_together() -> None:
    counter, gauge = (
        CounterMetric("labos_x_total", "x", ("a",), most=2),
        GaugeMetric("labos_y", "y", ("a",), most=2),
    )
    spread = Distribution("labos_z_seconds", "z", ("a",), most=2)
    for _ in range(2):
        for name in "abcd":
            counter.add((name,))
            spread.observe(1.0, (name,))
    gauge.replace({(name,): 1.0 for name in "abcd"})
    found = both(counter, gauge, spread)
    assert found["labos_x_total", (("a", "other"),)] == 4.0
    assert found["labos_y", (("a", "other"),)] == 2.0
    assert found["labos_z_seconds_count", (("a", "other"),)] == 4.0
    registry = MetricRegistry([counter, gauge, spread])
    registry.text()
    assert registry.counts == registry.most == 3 + 3 + 6


def test_a_counter_that_is_worked_out_never_goes_down() -> None:
    counter = ComputedCounter("labos_x_total", "x", ("a",))
    counter.replace({("one",): 5.0, ("two",): 1.0})
    counter.replace({("one",): 4.5, ("two",): 2.0})
    assert both(counter) == {("labos_x_total", (("a", "one"),)): 5.0, ("labos_x_total", (("a", "two"),)): 2.0}
    counter.set(3.0, ("one",))
    assert both(counter)["labos_x_total", (("a", "one"),)] == 5.0


def test_a_gauge_forgets_what_is_gone_and_has_room_again() -> None:
    gauge = GaugeMetric("labos_y", "y", ("a",), most=2)
    gauge.replace({("a",): 1.0, ("b",): 1.0})
    gauge.replace({("c",): 3.0, ("b",): 1.0})
    assert both(gauge) == {("labos_y", (("a", "b"),)): 1.0, ("labos_y", (("a", "c"),)): 3.0}
    gauge.clear()
    assert MetricRegistry([gauge]).text() == ""
