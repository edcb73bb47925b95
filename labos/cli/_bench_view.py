"""The visible state of a simulated bench, beside the state according to the log."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import click
import msgspec

from labos.cli._out import count_each, show_lines, show_table
from labos.core.envelope import Record
from labos.core.ids import local
from labos.core.state import LabState
from labos.node.world import FLOOR, World, lid_of
from labos.services.log import fold_to
from labos.services.truth import bench_name, find_plates_by_labware, list_differences
from labos.store import SqlEventStore

TRIES = 20
PAUSE_S = 0.1
HAND, LID = "hand:", lid_of("")


class BenchView(msgspec.Struct, frozen=True):
    """The simulated bench of a workcell. ``places`` maps places to what is there, bottom to top; ``fallen``
    lies on the floor; ``differs`` are the differences from the log at ``position``, in words; ``asked`` are
    the questions that wait for a person."""

    workcell: str
    position: int
    places: dict[str, tuple[str, ...]]
    fallen: tuple[str, ...]
    differs: tuple[str, ...]
    asked: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        return not self.differs


def read_bench(store: SqlEventStore, path: Path) -> BenchView:
    """Read a bench that has a file. Bench and log cannot be read at the same moment: a difference counts only
    if it is still there after a moment without motion and without new events."""
    with closing(World(str(path))) as world:
        for _ in range(TRIES):
            position = store.head().position
            before = world.last_motion(), position
            state, records = fold_to(store, position), list(store.read(upto=position))
            sight = _compare(world, path.stem, state, records)
            if sight.agrees:
                break
            time.sleep(PAUSE_S)
            if before == (world.last_motion(), store.head().position):
                break
        return sight


def _compare(world: World, workcell: str, state: LabState, records: list[Record]) -> BenchView:
    plates = find_plates_by_labware(world, records)
    known = {plate: labware for labware, plate in plates.items()}

    def name_plate(plate: str) -> str:
        kind = world.kind(plate)
        return f"{known[plate]} ({kind})" if plate in known else kind

    there = world.list_contents()
    expected = [f"{place}: " for place in (FLOOR, *_list_possible(state, plates, there))]
    # An action that the device has just finished is not in the log yet.
    expected += [f"{local(action.module)} did {action.name} " for action in state.actions.open.values()]
    differs = list_differences(world, state, records, workcell)
    return BenchView(
        workcell=workcell,
        position=state.position,
        places={place: tuple(map(name_plate, plates)) for place, plates in there.items() if place != FLOOR},
        fallen=tuple(map(name_plate, there.get(FLOOR, []))),
        differs=tuple(found for found in differs if not found.startswith(tuple(expected))),
        asked=tuple(question.id for question in state.interventions.open.values()),
    )


def _list_possible(state: LabState, plates: dict[str, str], there: dict[str, list[str]]) -> list[str]:
    """The stations where labware stands that the log lists only as possible there."""
    places = {plate: place for place, standing in there.items() for plate in standing}
    stations = state.bench.stations
    return [
        local(station)
        for item in state.bench.labware.values()
        for station in item.maybe
        if station and bench_name(stations[station].spec) == places.get(plates.get(item.id, ""))
    ]


def show(sight: BenchView) -> None:
    """The bench as a table, and whether the log agrees."""
    rows = [(_place(place), count_each(plates)) for place, plates in sight.places.items()]
    rows += [("on the floor", count_each(sight.fallen))] if sight.fallen else []
    show_table(("place", "what is there"), rows, title=f"The simulated bench of {sight.workcell}")
    if sight.agrees:
        click.echo(f"The log agrees (after event {sight.position}).")
    else:
        click.echo(f"The log differs (after event {sight.position}):")
        show_lines(sight.differs, "- ")
    if sight.asked:
        click.echo(f"A person is asked: {', '.join(sight.asked)} (labos interventions).")


def _place(place: str) -> str:
    if place.startswith(HAND):
        return f"in the hand of {place.removeprefix(HAND)}"
    return f"on {place.removeprefix(LID)}" if place.startswith(LID) else place
