"""What things hang on and what hangs on them, of a lab whose whole day is known."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest

from labos.audit import difference
from labos.audit.database import open_audit
from labos.audit.difference import list_differences
from labos.audit.formats import as_dot, as_prov
from labos.audit.graph import Entity
from labos.audit.liquids import trace_contents
from labos.audit.provenance import subject_of, trace
from labos.audit.query import ReadConnection, open_asker
from labos.core.labware import LabwareMoved, LiquidDrawn, LiquidTransferred, Sample, SamplesRegistered
from labos.core.registry import Event, decode
from labos.core.state import LabState
from labos.errors import NotFound
from labos.runtime.ledger import fold
from tests.integration.audit.logs import GrowingLog, project
from tests.support.audited import OT2, PLATE, audit_lab, before_the_pool
from tests.unit.services.logbook import seal_records


@pytest.fixture(scope="module")
def end() -> int:
    return audit_lab().position


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReadConnection]:
    url = f"sqlite:///{tmp_path_factory.mktemp('audited') / 'labos.db'}"
    database = open_audit(url)
    project(GrowingLog(audit_lab().records), database)
    database.close()
    with open_asker(url) as asker:
        yield asker


def names(asker: ReadConnection, subject: str, end: int, direction: str, kind: str) -> set[str]:
    graph = trace(asker, subject_of(asker, subject, end), end, direction)  # type: ignore[arg-type]
    things = [link.cause if direction == "up" else link.effect for link in graph.links]
    return {thing.name for thing in things if thing.kind == kind}


def position_of(kind: str, number: int = 0) -> int:
    """Where the event of a type stands."""
    return [r.head.position for r in audit_lab().records if r.head.type == kind][number]


# -- liquids -----------------------------------------------------------------------------------


def test_a_pooled_well_holds_shares_of_what_its_sources_held(lab: ReadConnection, end: int) -> None:
    parts = {part.origin.name: part for part in trace_contents(lab, "P1", "B7", end)}
    # 20 µL of A1 (10 A, 30 B, 7 C) and 10 µL of A2 (20 A, 5 B, 7 C) on 70 µL of water.
    wanted = {
        "water": 70.0,
        "A-17": 20 * 10 / 47 + 10 * 20 / 32,
        "B-03": 20 * 30 / 47 + 10 * 5 / 32,
        "C-99": 20 * 7 / 47 + 10 * 7 / 32,
    }
    assert {name: part.volume_ul for name, part in parts.items()} == pytest.approx(wanted, abs=1e-5)
    assert sum(part.share or 0 for part in parts.values()) == pytest.approx(1.0, abs=1e-5)
    assert parts["water"].origin.kind == "sample"


def test_before_it_was_pooled_it_held_what_the_sheet_said(lab: ReadConnection) -> None:
    assert [(p.origin.name, p.volume_ul) for p in trace_contents(lab, "P1", "B7", before_the_pool())] == [
        ("water", 70.0)
    ]
    assert trace_contents(lab, "P1", "B7", 1) == []


Mixed = Callable[..., ReadConnection]


@pytest.fixture
def mixed(tmp_path: Path) -> Iterator[Mixed]:
    """Makes the tables of a log that has these events and no others."""
    with ExitStack() as stack:

        def mix(*events: Event) -> ReadConnection:
            url = f"sqlite:///{tmp_path / 'labos.db'}"
            database = open_audit(url)
            project(
                GrowingLog(seal_records([(at, str(OT2), event) for at, event in enumerate(events)])), database
            )
            database.close()
            return stack.enter_context(open_asker(url))

        yield mix


def pour(
    liquid: str, well: str, volume: float, *lots: str, plate: str = "P1", certain: bool = True
) -> LiquidTransferred:
    return LiquidTransferred(plate, "", OT2, liquid, (well,), (volume,), lots, certain)  # type: ignore[arg-type]


def test_a_dilution_over_two_plates_keeps_its_shares(mixed: Mixed) -> None:
    asker = mixed(
        pour("dye", "A1", 10, "D1"),
        pour("water", "A1", 90),
        pour("P1/A1", "H12", 10, plate="P2"),
        LiquidDrawn(PLATE, "", OT2, ("A1",), (10.0,)),
        pour("water", "H12", 90, plate="P2"),
        pour("dye", "A1", 1000, "D2"),  # comes too late to be in P2
    )
    parts = trace_contents(asker, "P2", "H12", 6)
    assert [(p.origin.name, p.what, p.volume_ul, p.share) for p in parts] == [
        ("not known", "water", 99.0, 0.99),
        ("D1", "dye", 1.0, 0.01),
    ]
    assert names(asker, "lot:D1", 6, "down", "well") == {"P1/A1", "P2/H12"}
    assert names(asker, "lot:D2", 6, "down", "well") == {"P1/A1"}


def test_what_is_not_known_is_said(mixed: Mixed) -> None:
    unmeasured = (Sample("A1", "blood", None),)
    asker = mixed(
        SamplesRegistered(PLATE, "", "0" * 64, 1, unmeasured),
        pour("buffer", "A1", 50, "B1", certain=False),
        pour("A1", "B1", 5),
        pour("C9", "D1", 5),  # of C9 nothing was ever told
        pour("dye", "E1", 8, "L1", "L2"),
    )
    told = [(p.origin.name, p.volume_ul, p.share, p.certain) for p in trace_contents(asker, "P1", "B1", 9)]
    assert ("blood", None, None, True) in told
    assert all(share is None for _, _, share, _ in told)
    assert [p.certain for p in trace_contents(asker, "P1", "A1", 9) if p.origin.name == "B1"] == [False]
    assert trace_contents(asker, "P1", "D1", 9)[0].origin == Entity("well", "P1/C9")
    assert [p.volume_ul for p in trace_contents(asker, "P1", "E1", 9)] == [4.0, 4.0]


def test_wells_that_fill_each_other_do_not_hang_the_answer(mixed: Mixed) -> None:
    asker = mixed(*(pour(a, b, 5) for a, b in (("A1", "B1"), ("B1", "A1"), ("A1", "A1")) * 100))
    assert trace_contents(asker, "P1", "A1", 300)
    assert trace(asker, Entity("well", "P1/A1"), 300, "up").whole


# -- up and down -------------------------------------------------------------------------------


def test_a_recall_finds_every_result_of_a_lot_and_no_other(lab: ReadConnection, end: int) -> None:
    picture = subject_of(lab, "R2#3", end)
    assert picture.kind == "result"
    assert names(lab, "A-17", end, "down", "result") == {picture.name}
    assert names(lab, "water", end, "down", "result") == {picture.name}
    assert names(lab, "A-17", position_of("labware.samples_registered"), "down", "result") == set()


def test_a_result_hangs_on_everything_before_it_and_nothing_after(lab: ReadConnection, end: int) -> None:
    assert names(lab, "R2#3", end, "up", "lot") == {"A-17", "B-03", "C-99"}
    assert names(lab, "R2#3", end, "up", "user") == {"ada"}
    assert names(lab, "R2#3", end, "up", "sample") == {"water"}
    assert names(lab, "R2#3", end, "up", "run") == {"R1", "R2"}
    drivers = names(lab, "R2#3", end, "up", "driver")
    assert "rpl/camera_module camera 1" in drivers
    assert not any("sealer" in driver for driver in drivers)
    wells = [
        link
        for link in trace(lab, subject_of(lab, "R2#3", end), end, "up").links
        if link.relation == "was filled from"
    ]
    assert wells == [], "B7 was pooled after it was read"


def test_a_subject_is_found_by_what_people_call_it(lab: ReadConnection, end: int) -> None:
    wanted = {
        "P1": "labware",
        "P1/b7": "well",
        "R2": "run",
        "R2#3": "result",
        "R2#0": "action",
        "water": "sample",
        "A-17": "lot",
        "lot:A-17": "lot",
        "user:ada": "user",
        "driver:rpl/sealer a4s_sealer 1": "driver",
    }
    assert {text: subject_of(lab, text, end).kind for text in wanted} == wanted
    for text in ("P9", "P9/A1", "R99", "lot:water", "", "R2#99", "'; DROP TABLE labos_run"):
        with pytest.raises(NotFound, match="Name labware"):
            subject_of(lab, text, end)
    with pytest.raises(NotFound):
        subject_of(lab, "P1", 50)  # it was not there yet


def test_a_long_answer_ends_and_says_so(lab: ReadConnection, end: int) -> None:
    graph = trace(lab, Entity("user", "ada"), end, "down", most=10)
    assert len(graph.links) == 10
    assert not graph.whole


def test_other_programs_read_it(lab: ReadConnection, end: int) -> None:
    from prov.model import ProvDocument

    graph = trace(lab, subject_of(lab, "R2#3", end), end, "up")
    text = as_prov(graph, "lab-1")
    document = ProvDocument.deserialize(content=text, format="json")
    assert len(list(document.get_records())) == len(graph.links) + len(graph.entities)
    facts = json.loads(text)
    for relation in ("wasGeneratedBy", "used", "wasAssociatedWith", "wasInformedBy", "wasDerivedFrom"):
        assert facts[relation], relation
    dot = as_dot(graph)
    assert dot.count("->") == len(graph.links)


# -- the lab at a moment -----------------------------------------------------------------------


def lab_at(asker: ReadConnection, position: int) -> dict[str, Any]:
    """Where everything was, which runs there were, what was left, what was asked, which drivers answered."""
    runs = {
        f"{run} ({workflow}, {user})": difference._run_at(status, positions, position)
        for run, workflow, user, status, *positions in asker.fetch(difference._RUNS, position, position)
    }
    questions = {name: text for name, text, *_ in asker.fetch(difference._QUESTIONS, position, position)}
    return {
        "labware": difference._find_places(asker, position),
        "run": runs,
        "resource": difference._find_levels(asker, position),
        "question": questions,
        "driver": difference._find_drivers(asker, position),
    }


def test_the_lab_at_every_moment_is_the_folded_one(lab: ReadConnection, end: int) -> None:
    state, records = LabState(), audit_lab().records
    for position in range(0, end, 7):
        fold(state, records[state.position : position])
        found = lab_at(lab, position)
        assert found["labware"] == {item.id: item.station for item in state.bench.labware.values()}
        runs = {name.split(" ")[0] for name in found["run"]}
        assert runs == {*state.runs.active, *state.runs.queued}
        assert found["resource"] == {
            name: f"{lev.level:.10g}" for name, lev in state.resources.levels.items()
        }


def test_differences_are_what_happened_in_between(lab: ReadConnection, end: int) -> None:
    moves = [
        decode(r.head.type, r.head.schema, r.payload)
        for r in audit_lab().records
        if r.head.type == LabwareMoved.TYPE
    ]
    last = moves[-1]
    assert isinstance(last, LabwareMoved)
    first = position_of("run.submitted", 2)
    changes = {
        (c.about, c.what.split(":")[0]): (c.before, c.after) for c in list_differences(lab, first - 1, end)
    }
    assert changes["labware", "P2"] == ("", last.target)
    assert changes["run", "R3 (pcr, bo)"] == ("", "completed")
    assert changes["question", "I1"] == ("", "go_on, by bo")
    assert ("labware", "P1") not in changes
    assert list_differences(lab, end, end) == []


@pytest.mark.postgres
def test_postgres_gives_the_same_answers(lab: ReadConnection, end: int, postgres_url: str) -> None:
    database = open_audit(postgres_url)
    project(GrowingLog(audit_lab().records), database)
    database.close()

    def describe_graphs(asker: ReadConnection) -> str:
        subjects = ("P1", "P1/B7", "R2", "R2#3", "R2#0", "R2#1", "water", "A-17", "user:ada")
        graphs = [
            msgspec.to_builtins(trace(asker, subject_of(asker, subject, at), at, direction))
            for subject in subjects
            for direction in ("up", "down")
            for at in (end - 2,)
        ]
        moments = [[str(change) for change in list_differences(asker, 104, end)], lab_at(asker, 150)]
        return json.dumps([graphs, moments], sort_keys=True).replace("true", "1").replace("false", "0")

    with open_asker(postgres_url) as server:
        assert describe_graphs(server) == describe_graphs(lab)
