"""What a kernel counts: bounded, named as Prometheus wants it, and told in the reference."""

from __future__ import annotations

import re

import pytest

from labos.core.state import LabState
from labos.services.log import decode_events
from labos.services.twh import HEARD, Meter, measure
from labos.telemetry.kernel import KernelMetrics
from labos.telemetry.node import NodeMetrics
from labos.telemetry.series import LabMetric
from tests.golden.test_golden import NAMES, log


def families() -> list[LabMetric]:
    kernel = KernelMetrics(LabState)
    return [*kernel.registry.families, *NodeMetrics("driver", "1", simulated=True).families]


def test_a_kernel_never_has_more_than_50_000_series() -> None:
    assert KernelMetrics(LabState).registry.most <= 50_000


def test_names_are_as_prometheus_wants_them() -> None:
    names = [family.name for family in families()]
    assert len(names) == len(set(names))
    for family in families():
        assert re.fullmatch(r"labos_[a-z0-9]+(_[a-z0-9]+)*", family.name), family.name
        assert family.name.endswith("_total") == (family.kind == "counter"), family.name
        assert family.help.endswith("."), family.name
        assert not re.search(r"_(ms|minutes|hours|days|kb|mb)(_|$)", family.name), family.name


def test_no_label_names_what_there_is_no_end_of() -> None:
    unbounded = {"run", "labware", "action_id", "experiment", "intervention", "event", "station", "lot"}
    assert [family.name for family in families() if unbounded & set(family.labels)] == []


@pytest.mark.parametrize("name", NAMES)
def test_time_without_intervention_is_the_same_from_the_events_that_are_heard(name: str) -> None:
    whole = measure(log(name))
    meter = Meter(keep=1000)
    for event, head in decode_events(log(name)):
        if head.type in HEARD:
            meter.add(event, head)
        else:
            meter.pass_time(head.recorded_at)
    lab, workcells = meter.read_totals(0)
    assert (lab, workcells) == (whole.lab, whole.workcells)


def test_what_has_ended_long_ago_is_forgotten() -> None:
    name = NAMES[0]
    meter, whole = Meter(keep=1), Meter()
    for event, head in decode_events(log(name)):
        meter.add(event, head)
        whole.add(event, head)
    ended = sum(
        head.type in ("run.completed", "run.failed", "run.cancelled") for _, head in decode_events(log(name))
    )
    assert ended > 2
    assert len(meter.report().runs) < len(whole.report().runs)
    assert len(meter.names.runs) < len(whole.names.runs)
