"""The metrics of a lab whose database goes away, and comes back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.support.lab_process import until
from tests.support.postgres import PostgresServer
from tests.unit.telemetry.test_series import read

pytestmark = pytest.mark.postgres


def test_they_say_that_the_log_is_away(tmp_path: Path, own_postgres: Callable[[], PostgresServer]) -> None:
    server = own_postgres()
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path, server.create_database("lab"), simulate=True, on_database_loss="wait")
    with LabThread(settings, [cell], nodes="none") as lab:

        def read_metric(name: str) -> float | None:
            return read(httpx.get(f"{lab.url}/metrics").text).get((name, ()))

        with LabClient(lab.url) as client:
            client.submit("pcr", user="ada")
        assert read_metric("labos_log_available") == 1
        position = read_metric("labos_log_position")
        server.stop(immediate=True)
        until(lambda: read_metric("labos_log_available") == 0, "the log is known to be away")
        # What is folded is not known meanwhile, and is not told.
        found = read(httpx.get(f"{lab.url}/metrics").text)
        assert not [name for name, _ in found if name == "labos_module_state"]
        assert read_metric("labos_log_position") == position
        server.start()
        until(lambda: read_metric("labos_log_available") == 1, "the log is back")
        assert (read_metric("labos_log_reopened_total") or 0) >= 1
        queue = ("labos_queue_runs", (("workcell", "rpl"),))
        assert read(httpx.get(f"{lab.url}/metrics").text)[queue] == 1
        past = ("labos_twh_longest_seconds", (("scope", "lab"), ("workcell", "")))
        until(lambda: past in read(httpx.get(f"{lab.url}/metrics").text), "the past was measured again")
