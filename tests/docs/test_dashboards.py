"""The dashboards' files are what the code makes, what Grafana knows, and speak of metrics that exist."""

from __future__ import annotations

import itertools
import json
import re
from typing import Any

import pytest
import yaml
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models.dashboard import Dashboard

from deploy.grafana.make.boards import BOARDS
from deploy.grafana.make.parts import text_of
from labos.core.state import LabState
from labos.telemetry.kernel import KernelMetrics
from labos.telemetry.node import NodeMetrics
from tests.docs.markdown import ROOT
from tests.support.dashboards import FOLDER, boards, expand, questions

GRAFANA = ROOT / "deploy" / "grafana"
KINDS = {"row", "stat", "timeseries", "bargauge", "state-timeline", "table"}
MACROS = {"__rate_interval", "__range", "__all", "__from", "__to", "__value"}
OTHERS = {
    "up",
    "process_resident_memory_bytes",
    "process_cpu_seconds_total",
    "process_open_fds",
    "process_max_fds",
}

register_default_plugins()


def exprs(found: Any) -> list[str]:
    """All PromQL anywhere in a dashboard, annotations and variables too."""
    if isinstance(found, dict):
        own = [found[key] for key in ("expr",) if isinstance(found.get(key), str)]
        own += [q["query"] for q in [found.get("query")] if isinstance(q, dict) and "query" in q]
        return own + [expr for value in found.values() for expr in exprs(value)]
    return [expr for value in found for expr in exprs(value)] if isinstance(found, list) else []


def metrics() -> set[str]:
    """The names of all series that a lab shows."""
    families = [
        *KernelMetrics(LabState).registry.families,
        *NodeMetrics("", "", simulated=True).families,
    ]
    names = {f"{family.name}{end}" for family in families for end in ("", "_bucket", "_count", "_sum")}
    return names | OTHERS


def test_the_files_are_what_the_code_makes() -> None:
    made = {f"{board.uid}.json": text_of(board) for board in BOARDS}
    told = {path.name: path.read_text() for path in FOLDER.iterdir()}
    assert told == made, "run `python -m deploy.grafana.make`"


@pytest.mark.parametrize("uid", sorted(boards()))
def test_grafana_knows_every_key(uid: str) -> None:
    text = (FOLDER / f"{uid}.json").read_text()
    read = Dashboard.from_json(json.loads(text))
    again = json.dumps(read, cls=JSONEncoder, sort_keys=True, indent=1, ensure_ascii=False) + "\n"
    assert again == text  # a key that the types do not know would be lost


@pytest.mark.parametrize(
    "place", ["", "panels.1", "panels.1.targets.0", "panels.1.fieldConfig.defaults", "templating.list.0"]
)
def test_a_key_that_grafana_does_not_know_is_noticed(place: str) -> None:
    board = boards()["labos-twh"]
    found: Any = board
    for step in place.split(".") if place else ():
        found = found[int(step) if step.isdigit() else step]
    found["strange"] = 1
    assert json.loads(json.dumps(Dashboard.from_json(board), cls=JSONEncoder)) != board


@pytest.mark.parametrize("uid", sorted(boards()))
def test_panels_stand_beside_each_other(uid: str) -> None:
    board = boards()[uid]
    assert board["uid"] == uid
    assert len(uid) <= 40
    ids = [panel["id"] for panel in board["panels"]]
    assert len(ids) == len(set(ids))
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        place = panel["gridPos"]
        assert all(type(place[key]) is int for key in "hwxy")
        assert place["x"] + place["w"] <= 24
        cells = set(
            itertools.product(
                range(place["x"], place["x"] + place["w"]), range(place["y"], place["y"] + place["h"])
            )
        )
        assert not cells & taken, panel["title"]
        taken |= cells
        assert panel["type"] in KINDS
        if panel["type"] != "row":
            assert panel["title"]
            assert panel["description"].endswith("."), panel["title"]
            refs = [target["refId"] for target in panel["targets"]]
            assert refs
            assert len(refs) == len(set(refs))


def test_titles_and_uids_are_unique() -> None:
    found = list(boards().values())
    assert len({board["title"] for board in found}) == len({board["uid"] for board in found}) == 10


def test_every_data_source_is_provisioned() -> None:
    told = yaml.safe_load((GRAFANA / "provisioning/datasources/labos.yaml").read_text())["datasources"]
    known = {(source["type"], source["uid"]) for source in told}
    asked = re.findall(
        r'"type": "([\w-]+)",\s*"uid": "([\w-]+)"', "".join(path.read_text() for path in FOLDER.iterdir())
    )
    assert asked
    assert set(asked) <= known
    for uid, board in boards().items():
        chosen = {
            v["query"]: v["current"]["value"] for v in board["templating"]["list"] if v["name"] == "log"
        }
        assert set(chosen.items()) <= known
        asked_by = {question.plugin for question in questions() if question.board == uid}
        assert asked_by == set(chosen), uid


def test_every_metric_that_is_asked_for_exists() -> None:
    known = metrics()
    for uid, board in boards().items():
        for expr in exprs(board):
            named = re.sub(r'\{[^}]*\}|"[^"]*"', "", expr)
            asked = set(re.findall(r"\b(?:labos|process)_\w+", named))
            assert asked <= known, (uid, expr)
            assert asked or "up" in named, (uid, expr)


def test_every_variable_that_is_used_is_there() -> None:
    for uid, board in boards().items():
        names = {variable["name"] for variable in board["templating"]["list"]}
        used = set(re.findall(r"\$\{?(\w+)", json.dumps(board))) - MACROS
        assert used <= names, uid
        assert {"lab", "url"} <= names, uid
        for panel in board["panels"]:
            for target in panel.get("targets", ()):
                if "expr" in target:
                    expand(target["expr"])
                    assert "$lab" in target["expr"], (uid, panel["title"])
