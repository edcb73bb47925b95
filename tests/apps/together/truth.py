"""What the simulated instruments did, held against the log: each well filled once, each plate moved as often
as the log says, and every event of an experiment its own user's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from labos.core.envelope import Record
from labos.core.ids import local, workcell_of
from labos.core.labware import LabwareMoved, LabwarePlaced, LabwareRemoved
from labos.core.registry import decode
from labos.core.state import LabState
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.services.truth import find_plates_by_labware, list_differences
from tests.apps.together.bench import Bench
from tests.apps.together.programs import Program
from tests.support.lab_process import labos

MIXED = ("pipette", "synthesise")
EXPERIMENT_ENDS = ("experiment.started", "experiment.ended")
NOT_APPLICATIONS = ("labos", "olga", "")


def check_bench(bench: Bench, records: Sequence[Record]) -> Counter[str]:
    """Raises AssertionError where bench and log differ, or something was done twice. Returns how much was
    done: wells that were filled, moves, motions of all kinds."""
    state = LabState()
    fold(state, records)
    found: Counter[str] = Counter()
    for cell in bench.cells:
        with bench.world(cell) as world:
            wrong = list_differences(world, state, records, cell)
            assert wrong == [], f"{cell}: {wrong}"
            found["wells"] += check_wells(world, cell)
            found["moves"] += check_moves(world, records, cell)
            found["motions"] += len(world.motions())
    return found


def check_wells(world: World, cell: str) -> int:
    """No well was mixed twice; returns how many were mixed. A protocol that names no wells fills a plate."""
    filled: Counter[tuple[str, str, str]] = Counter()
    for verb in MIXED:
        for motion in world.motions(verb):
            for well in motion.facts.get("wells") or ["all"]:
                filled[verb, motion.plate, well] += 1
    again = {key: count for key, count in filled.items() if count > 1}
    assert not again, f"{cell}: mixed again: {again}"
    return len(filled)


def check_moves(world: World, records: Sequence[Record], cell: str) -> int:
    """No plate was put down anywhere more often than the log says; returns how often plates were put down."""
    told: dict[str, Counter[str]] = {}
    plates = find_plates_by_labware(world, records)
    for record in records:
        if not record.head.type.startswith("labware."):
            continue
        event = decode(record.head.type, record.head.schema, record.payload)
        match event:
            case LabwarePlaced():
                place = event.station
            case LabwareMoved():
                place = event.target
            case LabwareRemoved():
                place = event.where
            case _:
                continue
        if place and workcell_of(place) == cell:
            told.setdefault(plates.get(event.labware, event.labware), Counter())[local(place)] += 1
    down: dict[str, Counter[str]] = {}
    for motion in world.motions():
        if motion.verb in ("release", "discard") and not _is_between(motion.place):
            down.setdefault(motion.plate, Counter())[motion.place] += 1
    more = {plate: found - told.get(plate, Counter()) for plate, found in down.items()}
    again = {plate: dict(extra) for plate, extra in more.items() if extra}
    assert not again, f"{cell}: put down more often than the log says: {again}"
    return sum(sum(found.values()) for found in down.values())


def _is_between(place: str) -> bool:
    """Where a grip is changed, or in a device: no place of a move in the log."""
    return place == "wc.regrip" or (place.startswith("liconic.") and place != "liconic.exchange")


def check_owners(records: Sequence[Record], programs: Sequence[Program]) -> None:
    """Every event of an experiment was caused by its own user, by the lab, or by the operator; its runs are
    its user's."""
    owners = {name: program.app.user for program in programs for name in program.experiments}
    cells = {name: program.app.cell for program in programs for name in program.experiments}
    runs: dict[str, str] = {}
    for record in records:
        if record.head.type == "run.submitted":
            event: Any = decode(record.head.type, record.head.schema, record.payload)
            runs[str(event.run)] = str(event.experiment)
            assert event.experiment in owners, f"{event.run} is of no application"
            assert event.user == owners[event.experiment], event
    for record in records:
        head = record.head
        experiment = runs.get(head.correlation, head.correlation)
        if experiment not in owners or head.actor in (*NOT_APPLICATIONS, owners[experiment]):
            continue
        # A node speaks for its module: it has to be one of the experiment's own workcell.
        assert workcell_of(head.actor) == cells[experiment], f"{head.actor} in {experiment}: {head.type}"


def count_together(records: Sequence[Record]) -> int:
    """How many events are in the log while all experiments were under way."""
    at = {kind: [r.head.position for r in records if r.head.type == kind] for kind in EXPERIMENT_ENDS}
    begun, ended = (at[kind] for kind in EXPERIMENT_ENDS)
    return max(min(ended) - max(begun), 0)


def check_log(bench: Bench, records: Sequence[Record], programs: Sequence[Program]) -> None:
    """The chain is whole, each application has begun its experiment once and ended it, all runs have
    completed."""
    done = labos("verify", "--home", str(bench.up.home), timeout_s=240)
    assert done.returncode == 0, done.stdout + done.stderr
    types = Counter(record.head.type for record in records)
    assert types["run.submitted"] == types["run.completed"], types
    assert types["experiment.started"] == types["experiment.ended"] == len(programs), types
    assert [record.head.position for record in records] == list(range(1, len(records) + 1))
    for program in programs:
        resumed = [
            record
            for record in records
            if record.head.type == "experiment.resumed" and record.head.correlation == program.experiments[0]
        ]
        assert len(resumed) < program.lives, program.app.name
