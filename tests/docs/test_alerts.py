"""Alerts: the rules are what Prometheus takes, each is tried, and each has a page that says what to do."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml

from tests.docs.markdown import DOCS, ROOT
from tests.docs.test_dashboards import metrics
from tests.support.prometheus import promtool

FOLDER = ROOT / "deploy" / "prometheus"


def rules() -> list[dict[str, Any]]:
    groups = yaml.safe_load((FOLDER / "rules.yml").read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def alerts() -> dict[str, dict[str, Any]]:
    return {rule["alert"]: rule for rule in rules() if "alert" in rule}


def test_prometheus_takes_the_configuration() -> None:
    assert "SUCCESS" in promtool("check", "config", str(FOLDER / "prometheus.yml"))
    assert "SUCCESS" in promtool("check", "rules", str(FOLDER / "rules.yml"))


@pytest.mark.slow
def test_each_alert_does_what_it_should() -> None:
    assert "SUCCESS" in promtool("test", "rules", str(FOLDER / "rules_test.yml"))


def test_each_alert_is_tried() -> None:
    text = (FOLDER / "rules_test.yml").read_text()
    assert set(re.findall(r'alertname="(\w+)"', text)) == set(alerts())


def test_each_alert_has_a_page_and_each_page_an_alert() -> None:
    pages = {f"docs/runbooks/{path.name}": path.read_text() for path in (DOCS / "runbooks").glob("*.md")}
    for name, rule in alerts().items():
        assert rule["labels"]["severity"] in ("critical", "warning"), name
        assert rule["annotations"]["summary"].endswith("."), name
        assert f"`{name}`" in pages[rule["annotations"]["runbook"]], name
    assert {rule["annotations"]["runbook"] for rule in alerts().values()} == set(pages)


def test_rules_ask_for_metrics_that_exist() -> None:
    known = metrics()
    for rule in rules():
        named = re.sub(r'\{[^}]*\}|"[^"]*"|labos:\w+', "", rule["expr"])
        assert set(re.findall(r"\blabos_\w+", named)) <= known, rule
