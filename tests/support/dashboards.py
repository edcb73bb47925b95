"""Dashboards as Grafana reads them, and a lab under load whose metrics a real Prometheus keeps."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import LabosError
from labos.settings import Settings
from labos.spec import load_workcell
from tests.simulation.test_people import PERSON, RPL
from tests.support.prometheus import Prometheus

FOLDER = Path(__file__).parents[2] / "deploy" / "grafana" / "dashboards"

SEAL = """
name: seal
flowdef:
  - {name: take, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: to sealer
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: sealer.default}
  - {name: seal, module: sealer, action: seal}
  - name: away
    module: pf400
    action: transfer
    args: {source: sealer.default, target: wc.trash}
"""

LOOK = """
name: look
flowdef:
  - {name: look, module: operator, action: do, args: {instruction: look at the bench}}
"""

CONFIG = """
global: {{scrape_interval: 1s, scrape_timeout: 1s, evaluation_interval: 1s}}
scrape_configs:
  - job_name: labos
    http_sd_configs: [{{url: "{url}/metrics/targets", refresh_interval: 1s}}]
"""


class Target(msgspec.Struct, frozen=True):
    """One query of a panel; ``instant``: what is so now, else over time."""

    board: str
    panel: str
    kind: str
    unit: str
    expr: str
    legend: str
    instant: bool


def boards() -> dict[str, dict[str, Any]]:
    """The dashboards' files by uid."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(FOLDER.glob("*.json"))}


def targets(board: dict[str, Any]) -> Iterator[Target]:
    """All queries of a dashboard that go to Prometheus."""
    for panel in board["panels"]:
        for target in panel.get("targets", ()):
            if target["datasource"]["type"] == "prometheus":
                unit = panel["fieldConfig"]["defaults"].get("unit", "")
                named = (board["title"], panel["title"], panel["type"], unit)
                yield Target(*named, target["expr"], target["legendFormat"], bool(target.get("instant")))


class Question(msgspec.Struct, frozen=True):
    """One query of a panel that asks the log; ``plugin`` is Grafana's for its data source."""

    board: str
    panel: str
    plugin: str
    sql: str


def questions() -> list[Question]:
    """All queries of all dashboards that go to the log."""
    found = []
    for uid, board in boards().items():
        for panel in board["panels"]:
            for target in panel.get("targets", ()):
                sql = target.get("rawSql") or target.get("rawQueryText")
                if sql:
                    found.append(Question(uid, panel["title"], target["datasource"]["type"], sql))
    return found


def limit_to_span(sql: str, since_ns: int, until_ns: int) -> str:
    """A query of the log as Grafana sends it: its macros replaced by a time of whole milliseconds."""
    for name, moment in (("$__from", since_ns), ("$__to", until_ns)):
        sql = sql.replace(name, str(moment // 1_000_000))
    assert "$" not in sql, f"nobody replaces what is left in {sql}"
    return sql


def expand(expr: str) -> str:
    """A query as Grafana sends it: variables and macros replaced."""
    values = {"$lab": "lab", "$workcell": ".*", "$module": ".*", "$user": ".*"}
    macros = {"$__rate_interval": "5s", "$__range": "60s", "$__interval": "1s"}
    for name, value in {**macros, **values}.items():
        expr = expr.replace(name, value)
    assert "$" not in expr, f"nobody replaces what is left in {expr}"
    return expr


def answer_query(prometheus: Prometheus, target: Target, seconds: float) -> list[dict[str, Any]]:
    """What a query gives: now, or over the last ``seconds``."""
    query = expand(target.expr)
    return prometheus.ask(query) if target.instant else prometheus.ask_over(query, seconds, 1.0)


@contextmanager
def busy_lab(folder: Path) -> Iterator[tuple[LabThread, Prometheus]]:
    """A simulated lab that works for two users as long as the block lasts, with a person who answers and who
    takes a module out now and then; and a Prometheus that asks its kernel and nodes each second."""
    (folder / "cell.yaml").write_text(RPL.replace("modules:\n", PERSON, 1))
    cell = load_workcell(folder / "cell.yaml", descriptions())
    settings = Settings.make(folder / "lab", speed=60.0, simulate=True, node_metrics=True)
    with LabThread(settings, [cell], nodes="processes", grace_s=2.0) as lab:
        ended = threading.Event()
        worker = threading.Thread(target=_work, args=(lab.url, ended), name="load")
        worker.start()
        try:
            (folder / "prometheus").mkdir()
            with Prometheus(folder / "prometheus", CONFIG.format(url=lab.url)) as prometheus:
                yield lab, prometheus
        finally:
            ended.set()
            worker.join()


def _work(url: str, ended: threading.Event) -> None:
    seal, look = ({"text": text, "name": name} for text, name in ((SEAL, "seal"), (LOOK, "look")))
    with LabClient(url, patience_s=5.0) as client:
        experiment = client.start_experiment("colours", user="ada")
        turn = 0
        while not ended.wait(0.5):
            turn += 1
            with suppress(LabosError):  # what is refused now is not the load's concern
                _turn(client, seal, look, turn)
        with suppress(LabosError):
            client.end_experiment(experiment, "")


def _turn(client: LabClient, seal: dict[str, str], look: dict[str, str], turn: int) -> None:
    view = client.state(waits=False)
    if len(view["runs"]) < 4 + turn // 20 % 4:
        client.submit(seal, user=("ada", "ada", "bob")[turn % 3])
    if turn % 16 == 1:
        client.submit(look, user="bob")
    for question in view["interventions"]:
        client.resolve(question["id"], question["choices"][0]["name"], by="ada")
    if turn % 12 == 3:
        client.load("sciclops.tower1", "plate96", "bob", count=4)
    if turn % 60 == 59:
        client.unload("wc.trash", "bob")
    if turn % 40 == 9:
        client.take_out("camera_module", "cleaned", "ada")
    elif turn % 40 == 13:
        client.put_back("camera_module", "ada")
    elif turn % 40 == 6:
        client.cancel(client.submit(seal, user="ada"), "ada")
