"""``/metrics`` of a running lab, without nodes: what it says is what the lab says elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.support.lab_process import until
from tests.support.prometheus import promtool
from tests.unit.telemetry.test_series import read


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


def series(lab: LabThread) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    answer = httpx.get(f"{lab.url}/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return read(answer.text)


def value(lab: LabThread, name: str, **labels: str) -> Any:
    return series(lab).get((name, tuple(sorted(labels.items()))))


def test_promtool_finds_nothing_to_complain_about(lab: LabThread) -> None:
    assert promtool("check", "metrics", given=httpx.get(f"{lab.url}/metrics").text) == ""


def test_runs_and_waits_are_counted(lab: LabThread) -> None:
    with LabClient(lab.url) as client:
        before = value(lab, "labos_events_total", type="run.submitted")
        first, second = (client.submit("pcr", user=user) for user in ("ada", "bob"))
        client.pause(second, "bob")
        assert value(lab, "labos_events_total", type="run.submitted") == before + 2
        assert value(lab, "labos_runs", workcell="rpl", workflow="pcr", state="queued") == 1
        assert value(lab, "labos_runs", workcell="rpl", workflow="pcr", state="paused") == 1
        assert value(lab, "labos_user_runs", user="bob", state="paused") == 1
        assert value(lab, "labos_queue_runs", workcell="rpl") == 2
        assert value(lab, "labos_queue_oldest_age_seconds", workcell="rpl") > 0
        assert value(lab, "labos_waiting_steps", workcell="rpl", reason="module_down") == 1
        assert value(lab, "labos_module_state", workcell="rpl", module="sealer", state="gone") == 1
        for run in (first, second):
            client.cancel(run, "ada")
        ended = {"workcell": "rpl", "workflow": "pcr", "outcome": "cancelled"}
        assert value(lab, "labos_runs_ended_total", **ended) == 2
        assert value(lab, "labos_queue_runs", workcell="rpl") == 0
        # What was there once is shown as 0.
        assert value(lab, "labos_runs", workcell="rpl", workflow="pcr", state="queued") == 0
        assert value(lab, "labos_waiting_steps", workcell="rpl", reason="module_down") == 0


def test_the_log_is_counted_as_it_is_committed(lab: LabThread) -> None:
    with LabClient(lab.url) as client:
        found = series(lab)
        position = client.health()["position"]
    assert found["labos_log_position", ()] == position
    assert found["labos_log_unwritten_events", ()] == 0
    assert found["labos_commit_duration_seconds_count", ()] > 0
    assert found["labos_turn_duration_seconds_count", ()] > 0
    assert found["labos_store_size_bytes", ()] > 10_000
    assert found["labos_metrics_series", ()] > 100
    assert found["process_resident_memory_bytes", ()] > 10_000_000


def test_interventions_by_people_are_counted_from_the_logs_beginning(lab: LabThread) -> None:
    def at_hand() -> bool:
        return value(lab, "labos_twh_longest_seconds", scope="lab", workcell="") is not None

    until(at_hand, "the past was measured")
    causes = {"cause": "module.taken_out"}
    before = value(lab, "labos_human_interventions_total", **causes) or 0
    with LabClient(lab.url) as client:
        run = client.submit("pcr", user="ada")
        client.take_out("sealer", "broken", "ada")
        assert value(lab, "labos_human_interventions_total", **causes) == before + 1
        assert value(lab, "labos_module_state", workcell="rpl", module="sealer", state="out_of_service") == 1
        client.put_back("sealer", "ada")
        client.cancel(run, "ada")


def test_the_calibration_that_expires_first_is_measured(lab: LabThread) -> None:
    def ends() -> float | None:
        return value(lab, "labos_calibration_ends_timestamp_seconds", workcell="rpl")

    assert ends() is None
    with LabClient(lab.url) as client:
        client.calibrate("hidex", "ada")
        assert ends() is None
        client.calibrate("hidex", "ada", what="volume", until="2030-12-31")
        client.calibrate("sealer", "ada", until="2099-12-31")
        assert ends() == 1_924_992_000  # 2031-01-01T00:00:00Z
        client.calibrate("hidex", "ada", what="volume")
        assert ends() == 4_102_444_800  # 2100-01-01T00:00:00Z
        client.calibrate("sealer", "ada")
        assert ends() is None


def test_a_restarted_kernel_measures_the_past(lab: LabThread, tmp_path_factory: Any) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("again"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as first, LabClient(first.url) as client:
        client.submit("pcr", user="ada")
        client.take_out("sealer", "broken", "ada")
    with LabThread(settings, nodes="none") as second:
        until(lambda: value(second, "labos_human_interventions_total", cause="module.taken_out"), "the past")
        assert value(second, "labos_queue_runs", workcell="rpl") == 1
        assert value(second, "labos_kernel_epoch") == 2


def test_prometheus_is_told_where_to_ask(lab: LabThread) -> None:
    (kernel,) = httpx.get(f"{lab.url}/metrics/targets").json()
    assert kernel == {
        "targets": [lab.url.removeprefix("http://")],
        "labels": {"lab": "lab", "process": "kernel"},
    }
