"""Every query of every dashboard, asked of a real Prometheus that watches a lab at work."""

from __future__ import annotations

import time
from pathlib import Path
from xml.etree import ElementTree

import httpx

from tests.support.dashboards import Target, answer_query, boards, busy_lab, targets
from tests.support.drawing import draw, read
from tests.support.prometheus import Prometheus, promtool

PATIENCE_S = 30.0


def has_data(prometheus: Prometheus, target: Target) -> bool:
    """Whether a query gives a number."""
    return any(read(target, answer_query(prometheus, target, 30.0)))


def test_every_panel_shows_data(tmp_path: Path) -> None:
    left = [target for board in boards().values() for target in targets(board)]
    assert len(left) > 90
    with busy_lab(tmp_path) as (lab, prometheus):
        give_up = time.monotonic() + PATIENCE_S
        while left and time.monotonic() < give_up:
            left = [target for target in left if not has_data(prometheus, target)]
            time.sleep(0.5 if left else 0.0)
        assert [(target.board, target.panel, target.expr) for target in left] == []
        for board in boards().values():
            picture = draw(board, lambda target: answer_query(prometheus, target, 30.0))
            ElementTree.fromstring(picture)
            assert "no data" not in picture, board["title"]
        for utilisation in prometheus.ask("max_over_time(rate(labos_module_busy_seconds_total[5s])[1m:1s])"):
            assert float(utilisation["value"][1]) < 1.5, utilisation  # nothing looks like a new start
        down = [series["metric"] for series in prometheus.ask("up == 0")]
        assert down == []
        nodes = prometheus.ask('count(up{process="node",lab="lab"})')
        assert float(nodes[0]["value"][1]) > 10
        assert prometheus.labels("module", 'labos_node_info{module="sealer"}') == ["sealer"]
        # Variables find what they offer.
        for name, match in (
            ("lab", "labos_lab_info"),
            ("user", 'labos_user_module_seconds_total{lab="lab"}'),
        ):
            assert prometheus.labels(name, match), name
        address = next(t for t in httpx.get(f"{lab.url}/metrics/targets").json() if "module" in t["labels"])
        node = httpx.get(f"http://{address['targets'][0]}/metrics", headers={"accept": "text/plain"})
        assert promtool("check", "metrics", given=node.text) == ""
