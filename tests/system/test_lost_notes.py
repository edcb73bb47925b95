"""An application notes something, and the lab breaks off before it has answered: it is noted once."""

from __future__ import annotations

import json
from pathlib import Path

from labos.bootstrap import LabThread, descriptions
from labos.client import Experiment, LabClient
from labos.ports import LogQuery
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.proxy import Proxy

CELL = """\
labos: 1
name: corner
modules: [{name: sealer, model: a4s_sealer}]
"""


TOLD = b'{"detail": "The database broke off.", "remedy": "Look.", "code": "commit_in_doubt", "details": []}'
IN_DOUBT = b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/json\r\n"
IN_DOUBT += b"content-length: %d\r\n\r\n%s" % (len(TOLD), TOLD)
"""What the lab says when its database broke off while it wrote."""


def test_a_note_whose_answer_was_lost_is_not_repeated(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as lab:
        proxy = Proxy(int(lab.url.rpartition(":")[2]))
        try:
            with LabClient(lab.url) as client, Experiment(client, "app", "ada") as experiment:
                for instead in (b"", IN_DOUBT):
                    experiment.note("decision", "next", mixtures=[(1.0, 2.5), (3.0, 4.0)])
                    proxy.lose_next(b"POST", b"/notes", instead=instead)
                    with LabClient(proxy.url) as experiment.lab:  # the proxy judges a connection by its start
                        experiment.note("decision", "next", mixtures=[(1.0, 2.5), (3.0, 4.0)])
                    experiment.lab = client
                experiment.note("loop_ended", "mix")
        finally:
            proxy.close()
        assert proxy.lost == 2
        records = lab.runtime.store.select(LogQuery(types=("experiment.noted",)))
        notes = [json.loads(record.payload) for record in records]
    assert [note["name"] for note in notes] == ["next"] * 4 + ["mix"]
