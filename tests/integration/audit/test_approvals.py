"""Who approved what, as which digest, when and with which comment: in tables, and as a cause of what ran."""

from __future__ import annotations

import json
from pathlib import Path

from labos.audit.database import open_audit
from labos.audit.provenance import subject_of, trace
from labos.audit.query import open_asker
from labos.core.campaigns import Budget, Terms
from labos.core.decide.campaigns import AmendCampaign, SubmitCampaign, SubmitRow
from labos.core.decide.proposals import ApproveProposal, RefuseProposal
from labos.core.ids import CampaignId
from tests.integration.audit.logs import GrowingLog, project
from tests.simulation import mixes
from tests.unit.services.logbook import Logbook

C1 = CampaignId("C1")


def test_every_answer_stands_in_a_table_with_the_digest_it_was_about(tmp_path: Path) -> None:
    book = Logbook()
    book.furnish()
    book.do(SubmitCampaign("screen", "ada", "pcr", "rpl", 9, "t", "d", propose=True), "ada")
    first = book.state.approvals.open["C1"].digest
    book.do(AmendCampaign(C1, Terms(budget=Budget(runs=5))), "ada")
    second = book.state.approvals.open["C1"].digest
    book.at(60)
    terms = Terms(priority=2, budget=Budget(runs=1))
    book.do(ApproveProposal("C1", second, "olga", "one is enough", terms=terms), "olga")
    book.do(SubmitRow(C1, 0, mixes.PLANS["pcr"].plan))
    book.do(SubmitCampaign("screen", "bo", "pcr", "rpl", 9, "t2", "d", propose=True), "bo")
    book.do(RefuseProposal("C2", "olga", "no plates"), "olga")
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    database = open_audit(url)
    project(GrowingLog(book.records), database)
    database.close()
    with open_asker(url) as asker:
        rows = asker.fetch(
            "SELECT subject, digest, answer, answered_by, comment, before, changed, changes "
            "FROM approvals ORDER BY requested_position"
        )
        assert [row[:6] for row in rows] == [
            ("C1", first, "changed", "", "", ""),
            ("C1", second, "approved", "olga", "one is enough", ""),
            ("C2", rows[2][1], "refused", "olga", "no plates", "C1"),
        ]
        assert json.loads(rows[2][6]) == ["table", "terms"]
        assert json.loads(rows[1][7])["terms"]["priority"] == 2
        assert asker.fetch("SELECT campaign, status, priority FROM campaigns ORDER BY 1")[0] == (
            "C1",
            "open",
            2,
        )
        graph = trace(asker, subject_of(asker, "R1", book.position), book.position, "up")
        approved = [link for link in graph.links if link.relation == "approved by"]
        assert [(str(link.effect), link.cause.name) for link in approved] == [("run R1", "olga")]
        # Before it was approved, nobody had.
        early = trace(asker, subject_of(asker, "R1", book.position), approved[0].position - 1, "up")
        assert not [link for link in early.links if link.relation == "approved by"]
