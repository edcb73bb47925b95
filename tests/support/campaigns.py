"""The log of a small lab, on paper, with campaigns of every kind of end."""

from __future__ import annotations

from labos.core.campaigns import Budget, Terms
from labos.core.decide.campaigns import (
    AmendCampaign,
    CancelCampaign,
    PauseCampaign,
    RefuseRow,
    ResumeCampaign,
    SubmitCampaign,
    SubmitRow,
)
from labos.core.decide.cancelling import CancelRun
from labos.core.ids import CampaignId, InterventionId, LabwareId, RunId, StationName
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.labware import LabwareRemoved
from labos.core.topics import Choice
from tests.simulation import mixes
from tests.unit.services.logbook import START_NS, Logbook

PLAIN = Terms()
GO_ON = (Choice("go_on", "the run goes on"),)


def campaign_lab() -> Logbook:
    """Of Ada's campaign one row is completed, one refused, one cancelled, and one stays in the queue; in
    between it is paused, a question is answered, and it goes on under other terms. Bo cancels his, another
    one is stopped by its budget, and of Ada's last one nothing can be carried out."""
    book = Logbook()
    book.furnish()
    first = _submit(book, "screen", "ada", 4, Terms(priority=1, tags=("colours",)))
    row = _row(book, first, 0)
    book.at(10)
    book.do(PauseCampaign(first, "the reader is cleaned"))
    book.at(20)
    book.do(ResumeCampaign(first))
    book.carry_through(row)
    parking = StationName("rpl/wc.parking")
    book.write([LabwareRemoved(LabwareId("P1"), "", parking, "it was carried away")], "ada")
    question = InterventionId("I1")
    ask = InterventionRequested(question, "late_step", row, f"A step of {row} is late.", GO_ON, run=row)
    book.write([ask])
    book.write([InterventionResolved(question, "go_on", "ada", "the door was ajar")], "ada")
    book.do(RefuseRow(first, 1, "there is no such well"), "labos")
    book.do(AmendCampaign(first, Terms(priority=2, deadline=START_NS + 3600 * 10**9)))
    book.do(CancelRun(RunId(_row(book, first, 2)), why="the plate is dirty"))
    second = _submit(book, "titration", "bo", 3)
    _row(book, second, 0)
    book.at(200)
    book.do(CancelCampaign(second, why="the wrong table"), "bo")
    third = _submit(book, "trial", "bo", 2, Terms(budget=Budget(runs=1)))
    book.carry_through(_row(book, third, 0))
    book.do(SubmitRow(third, 1, mixes.PLANS["cp_newplate"].plan), "labos")
    _row(book, first, 3)
    fourth = _submit(book, "plates", "ada", 1)
    book.do(RefuseRow(fourth, 0, "there is no such plate"), "labos")
    return book


def _submit(book: Logbook, name: str, user: str, rows: int, terms: Terms = PLAIN) -> CampaignId:
    book.do(SubmitCampaign(name, user, "cp_newplate", "rpl", rows, "t" * 64, "d" * 64, terms), user)
    return CampaignId(f"C{book.state.campaigns.named}")


def _row(book: Logbook, campaign: CampaignId, row: int) -> str:
    book.do(SubmitRow(campaign, row, mixes.PLANS["cp_newplate"].plan), "labos")
    return f"R{book.state.runs.named}"
