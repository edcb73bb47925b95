"""The questions on a log in PostgreSQL, while a kernel lives and after it."""

from __future__ import annotations

import json

import pytest

from labos.cli.app import main
from labos.core.ids import LabId
from labos.store import find_lease_holder, open_store
from tests.unit.services.logbook import two_users

QUESTIONS = ("log", "stations", "labware", "runs", "twh", "experiments", "interventions")


@pytest.mark.postgres
def test_every_question_is_answered(postgres_url: str, capsys: pytest.CaptureFixture[str]) -> None:
    store = open_store(postgres_url)
    try:
        head = store.claim(LabId("lab-1"), "pid 1", 60.0)
        store.append(head, two_users().records)
        assert find_lease_holder(postgres_url) == "pid 1"
        for name in QUESTIONS:
            assert main([name, "--database", postgres_url]) == 0, name
        assert main(["explain", "R2", "--database", postgres_url]) == 0
        assert "no kernel runs" not in capsys.readouterr().out
        assert main(["verify", "--database", postgres_url]) == 1
        said = capsys.readouterr().out
        assert f"The log is intact: {two_users().position} records" in said
        assert "names the blob" in said, "these records came without their blobs"
        store.release(head.epoch)
    finally:
        store.close()
    assert find_lease_holder(postgres_url) == ""
    assert main(["db", "status", "--json", "--database", postgres_url]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["position"] == two_users().position
    assert facts["bytes"] > 0
    assert facts["kernel"] == ""
