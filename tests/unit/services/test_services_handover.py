"""What the next shift is told of a day that the logbook knows."""

from __future__ import annotations

from pathlib import Path

from labos.core.decide.actions import DoubtAction
from labos.core.decide.handover import HandOver
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.nodes import JoinNode, TakeOut
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import Replenish
from labos.core.ids import LabwareId, ModuleName, Owner
from labos.core.resources import LevelSet
from labos.services.handover import Handover, read_handover
from labos.services.waits import KEPT
from labos.store import open_store
from tests.support.bench import module, plan, step, workcell
from tests.unit.services.logbook import SECOND, START_NS, Logbook

SEALER = ModuleName("rpl/sealer")


def report(book: Logbook, home: Path, since_s: float, until_s: float) -> Handover:
    store = open_store(book.save(home), create=False, read_only=True)
    try:
        return read_handover(store, START_NS + int(since_s * SECOND), START_NS + int(until_s * SECOND))
    finally:
        store.close()


def a_day() -> Logbook:
    """R1 ends; R2 stands before a question; R3 and R4 are queued, one of them with foil past its date."""
    book = Logbook()
    book.furnish()
    book.write([LevelSet(SEALER, "foil", 2, 100, "old")])
    book.do(Replenish(SEALER, "foil", 1, "new", "2025-01-31"))
    book.at(10)
    book.carry_through(book.submit("pcr"), seconds=10)
    book.at(1000)
    second = book.submit("pcr", "bo")
    book.carry_through(second, seconds=10, steps=1)
    book.do(DoubtAction(book.start(second, 1), "its node died"), "labos")
    for _ in range(2):
        book.submit("pcr", "bo")
    book.do(TakeOut(ModuleName("rpl/hidex"), "a new lamp", START_NS + 5000 * SECOND, book.clock.now))
    book.do(HandOver(LabwareId("P1"), Owner("user:bo"), "ada"))
    return book


def test_what_the_next_shift_has_to_know(tmp_path: Path) -> None:
    found = report(a_day(), tmp_path, 0, 1200)
    assert [(run.run, run.user, run.done) for run in found.running] == [("R2", "bo", 1)]
    assert [run.run for run in found.queued] == ["R3", "R4"]
    assert all(run.waits for run in found.queued)
    assert [(run.run, run.status) for run in found.ended] == [("R1", "completed")]
    (asked,) = found.questions
    assert (asked.run, asked.of, asked.answer) == ("R2", "", "labos resolve I1 done | not_done | gone")
    (away,) = found.away
    assert (away.module, away.why, away.until) == ("hidex", "a new lamp", START_NS + 5000 * SECOND)
    pieces = {piece.labware: piece for piece in found.labware}
    assert (pieces["P1"].station, pieces["P1"].owner, pieces["P1"].given_by) == (
        "wc.output.1",
        "user:bo",
        "ada",
    )
    assert len(pieces["P2"].maybe) > 1, "nobody knows where it is"
    short = next(short for short in found.runs_out if short.what == "sealer foil")
    assert (short.run, short.step) == ("R4", "Seal plate/Seal")
    assert [(pack.lot, pack.left) for pack in found.expired] == [("new", 1)]
    assert found.twh.interventions == 1, "the module that was taken out"


def test_only_this_shift_counts(tmp_path: Path) -> None:
    found = report(a_day(), tmp_path, 900, 1200)
    assert found.ended == ()
    assert (found.twh.longest.commands, found.since) == (1, START_NS + 900 * SECOND)
    young = report(a_day(), tmp_path / "young", -10_000, 1200)
    assert young.since == START_NS, "the lab is younger than its shift"


def test_an_order_of_the_kernel_is_assumed_only_while_one_runs(tmp_path: Path) -> None:
    cell = workcell([module("mill"), module("saw")], [])
    book = Logbook()
    book.do(ApplyWorkcell(cell))
    for each in cell.modules:
        book.do(JoinNode(each.name, "j", "i", each.driver, "1", "", "IDLE", True), each.name)
    for name in ("mill", "saw"):
        book.do(SubmitRun(plan(step(name)), "ada", {}))
    book.start("R1", 0)
    store = open_store(book.save(tmp_path), create=False, read_only=True)
    try:
        found, dead = (
            read_handover(store, START_NS, START_NS + 9 * SECOND, kernel_runs=lives)
            for lives in (True, False)
        )
    finally:
        store.close()
    assert [(run.run, run.waits) for run in found.queued] == [("R2", (KEPT,))]
    assert [(run.run, run.waits) for run in dead.queued] == [("R2", ())]
