"""The log of a small lab, on paper, of which auditors ask: lots, a mixture, a sealed plate, a question."""

from __future__ import annotations

from typing import Any

from labos.core.canonical import digest
from labos.core.decide.actions import FinishAction
from labos.core.decide.campaigns import PauseCampaign, RefuseRow, SubmitCampaign
from labos.core.ids import CampaignId, InterventionId, LabwareId, ModuleName
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.labware import LiquidDrawn, LiquidTransferred, Sample, SamplesRegistered
from labos.core.model import MAIN
from labos.core.modules import ModuleCalibrated
from labos.core.resources import LevelSet, ResourceReplenished
from labos.core.topics import Choice
from tests.simulation import mixes
from tests.unit.services.logbook import Logbook

OT2 = ModuleName("rpl/ot2_cp_gamma")
PLATE = LabwareId("P1")
SHEET = digest(mixes.FILES[0])

MEASURED: dict[str, Any] = {"quantity": "absorbance", "wells": {"A1": 0.52, "A2": 0.71, "B7": 0.60}}


def finish_with(book: Logbook, run: str, results: dict[str, Any]) -> None:
    """All steps of a run, one second each; the named ones return a result."""
    submitted = next(e.event for e in book.entries if getattr(e.event, "run", "") == run)
    plan = book.state.runs.plans[submitted.plan].plan  # type: ignore[attr-defined]
    now = (book.clock.now_ns() - 1_750_000_000_000_000_000) / 1e9
    for index, step in enumerate(plan.steps):
        if step.part != MAIN:
            continue
        action = book.start(run, index)
        now += 1
        book.at(now)
        module = book.state.actions.open[action].module
        book.do(FinishAction(action, 1, True, "all", results.get(step.key)), module)


def audit_lab() -> Logbook:
    """Ada mixes colours of known lots on P1 and reads it; Bo seals P2 in a PCR and answers a question. Then
    well B7 is pooled from A1 and A2, and Bo pauses a campaign."""
    book = Logbook()
    book.furnish()
    for colour, lot in (("color_A", "A-17"), ("color_B", "B-03"), ("color_C", "C-99")):
        book.write([LevelSet(OT2, colour, 0.0, 20_000.0)], "ada")
        book.write([ResourceReplenished(OT2, colour, 10_000.0, lot)], "ada")
    book.write([ModuleCalibrated(OT2, "ada", "volume", "K-2041", "", "2026-06-30", "yearly")], "ada")
    first = book.submit("cp_newplate", "ada")
    finish_with(book, first, {})
    sheet = (Sample("B7", "water", 70.0),)
    book.write([SamplesRegistered(PLATE, "", SHEET, 1, sheet)], "ada")
    mix = book.submit("cp_mixcolor", "ada")
    book.at(60)
    finish_with(book, mix, {"Take picture": MEASURED})
    pcr = book.submit("pcr", "bo")
    asked = InterventionRequested(
        *(InterventionId("I1"), "late_step", pcr, f"A step of {pcr} is late: is the door closed?"),
        (Choice("go_on", "the run goes on"),),
        run=pcr,
    )
    book.at(100)
    book.write([asked])
    book.at(115)
    book.write([InterventionResolved(InterventionId("I1"), "go_on", "bo", "the door was ajar")], "bo")
    book.at(120)
    finish_with(book, pcr, {})
    book.at(240)
    pooled = [
        LiquidTransferred(PLATE, "", OT2, "A1", ("B7",), (20.0,)),
        LiquidTransferred(PLATE, "", OT2, "A2", ("B7",), (10.0,)),
        LiquidDrawn(PLATE, "", OT2, ("A1", "A2"), (20.0, 10.0)),
    ]
    book.write(pooled, str(OT2))
    book.do(SubmitCampaign("titration", "bo", "pcr", "rpl", 3, "t" * 64, "d" * 64), "bo")
    book.do(RefuseRow(CampaignId("C1"), 0, "there is no such well"), "labos")
    book.do(PauseCampaign(CampaignId("C1"), "row 0 names no well"), "bo")
    return book


def before_the_pool() -> int:
    """The position of the last event before B7 was pooled."""
    drawn = max(r.head.position for r in audit_lab().records if r.head.type == LiquidDrawn.TYPE)
    return drawn - 3  # two transfers come before what they drew
