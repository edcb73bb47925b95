"""Compares a simulated bench with the log: every plate is where the log says, and no work was done twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from labos.core.actions import ActionFailed, ActionReconciled, ActionRequested, ActionSucceeded
from labos.core.bench import Labware
from labos.core.effects import list_moved
from labos.core.envelope import Record
from labos.core.ids import ActionId, StationName, local, workcell_of
from labos.core.invariants import find_broken
from labos.core.labware import LabwarePlaced
from labos.core.model import StationSpec
from labos.core.registry import decode
from labos.core.state import LabState
from labos.node.world import World, lid_of


def list_differences(
    world: World, state: LabState, records: Sequence[Record], workcell: str = ""
) -> list[str]:
    """The differences between bench and log; empty if they agree about every plate. Each workcell of a lab
    has its own bench."""
    found = [f"{m.device} {m.facts['what']} at {m.place}" for m in world.crashes()]
    plates = find_plates_by_labware(world, records)
    places = world.list_contents()
    pieces = [item for item in state.bench.labware.values() if workcell in ("", workcell_of(item.station))]
    carried = {item.id: way for item in pieces if (way := _list_possible_places(state, item))}
    for labware, way in carried.items():
        found += _take_in_progress(way, labware, plates.get(labware, labware), places)
    for name, station in state.bench.stations.items():
        if station.spec.kind == "waste" or name in state.bench.shelves:
            continue
        if workcell not in ("", workcell_of(name)):
            continue
        truth = places.pop(bench_name(station.spec), [])
        resting = [item for item in station.labware if item not in carried]
        for stored in resting:  # where the device assigned the slot and reported it, unless it lost count
            slot = state.bench.labware[stored].variables.get("slot", "")
            own = f"{local(station.spec.module)}."
            plate = plates.get(stored, stored)
            any_slot = next((p for p, held in places.items() if p.startswith(own) and held == [plate]), "")
            where = f"{own}{slot}" if slot else any_slot if slot is None else ""
            truth = [*truth, *places.pop(where, [])] if where else truth
        recorded = ["?"] * len(station.stock) + [plates.get(item, item) for item in resting]
        if len(truth) != len(recorded):
            found.append(f"{local(name)}: bench {truth}, log {recorded}")
            continue
        named = recorded[len(station.stock) :]
        really = truth[len(station.stock) :]
        if sorted(named) != sorted(really):
            found.append(f"{local(name)}: bench {really}, log {named}")
    for item in pieces:
        if item.on and not item.maybe:
            lying = places.pop(lid_of(plates.get(item.on, item.on)), [])
            if lying != [plates.get(item.id, item.id)]:
                found.append(f"on {item.on}: bench {lying}, log {item.id}")
    for stacked in [plate for plate in list_plates_in(state, world) if plate not in plates.values()]:
        places.pop(lid_of(stacked), None)
    found += [f"{place}: bench {plates_}, log nothing" for place, plates_ in places.items()]
    found += find_repeated_work(world, records, workcell)
    fault = find_broken(state)
    return [*found, fault] if fault else found


def _list_possible_places(state: LabState, item: Labware) -> list[str]:
    """The places on the bench where labware may be while an action in flight carries it; an empty name stands
    for the waste. The list is empty if no action carries it."""
    if not item.moving or item.maybe:
        return []
    action = state.actions.open[ActionId(item.moving)]
    moves = [e for e in list_moved(action.effects) if e.labware == item.id]
    stops = [state.bench.stations[stop].spec for e in moves for stop in (e.source, e.via, e.target) if stop]
    places = ["" if stop.kind == "waste" else bench_name(stop) for stop in stops]
    return [*places, f"hand:{local(action.module)}"] if places else []


def _take_in_progress(way: list[str], name: str, plate: str, places: dict[str, list[str]]) -> list[str]:
    """Labware that is being carried may be at any place on its way; the log does not say which. It is removed
    from ``places``."""
    here = next((place for place, standing in places.items() if plate in standing), "")
    if here not in way:
        return [f"{plate} at {here or 'no place'}, log {name} on its way over {way}"]
    if here:
        places[here] = [standing for standing in places[here] if standing != plate]
        if not places[here]:
            del places[here]
    return []


def list_bench_contents(
    world: World, state: LabState, records: Sequence[Record]
) -> dict[StationName, list[str]]:
    """The visible content of each station of a simulated bench, bottom to top: labware by its id in the log,
    else by its type; with its lid. The content of a waste is not visible."""
    names = {plate: name for name, plate in find_plates_by_labware(world, records).items()}
    places = world.list_contents()

    def name_plate(plate: str) -> str:
        name = names.get(plate, "")
        return name if name in state.bench.labware else world.kind(plate)

    def piece(plate: str) -> str:
        lids = places.get(lid_of(plate), [])
        return "+".join([name_plate(plate), *(name_plate(lid) for lid in lids)])

    found: dict[StationName, list[str]] = {}
    for name, station in state.bench.stations.items():
        if station.spec.kind != "waste" and name not in state.bench.shelves:
            stands = places.pop(bench_name(station.spec), [])
            stacked = station.spec.kind == "stack"
            found[name] = [world.kind(plate) if stacked else piece(plate) for plate in stands]
    for name in found:  # slots that a device chooses itself are not separate stations
        if local(name).endswith(".slots"):
            own = f"{local(state.bench.stations[name].spec.module)}."
            for place in [place for place in places if place.startswith(own)]:
                found[name] += [piece(plate) for plate in places.pop(place)]
    return found


def bench_name(station: StationSpec) -> str:
    """The name of a place on the bench: an arm's hand is not a separate place there."""
    return f"hand:{local(station.module)}" if station.kind == "gripper" else local(station.name)


def list_plates_in(state: LabState, world: World) -> list[str]:
    """The plates in the stacks: neither they nor their lids have ids yet."""
    stacks = [name for name, station in state.bench.stations.items() if station.spec.kind == "stack"]
    return [plate for name in stacks for plate in world.at(local(name))]


WORK = {"seal": "seal", "peel": "peel", "cycle": "run_program", "read": "run_assay"}
"""The work that devices record when they have finished, and the action to which it belongs. A reading may be
one of many readings of another action."""


def find_repeated_work(world: World, records: Sequence[Record], workcell: str = "") -> list[str]:
    """Devices that finished some work more often than the log has ends of it."""
    done = Counter((m.device, WORK[m.verb]) for m in world.motions() if m.verb in WORK)
    names: dict[str, tuple[str, str]] = {}
    recorded: Counter[tuple[str, str]] = Counter()
    for record in records:
        if not record.head.type.startswith("action."):
            continue
        event = decode(record.head.type, record.head.schema, record.payload)
        if isinstance(event, ActionRequested) and workcell in ("", workcell_of(event.module)):
            names[event.action] = (local(event.module), event.name)
        elif isinstance(event, ActionSucceeded | ActionFailed | ActionReconciled) and event.action in names:
            recorded[names[event.action]] += 1
    return [
        f"{device} did {name} {count} times, the log says {recorded[device, name]}"
        for (device, name), count in sorted(done.items())
        if count > recorded[device, name] and (name != WORK["read"] or (device, name) in names.values())
    ]


def find_plates_by_labware(world: World, records: Sequence[Record]) -> dict[str, str]:
    """The plate for each labware id: both are numbered in the order in which they are taken from stacks, or
    placed elsewhere by people."""
    taken: dict[str, list[str]] = {}
    put: dict[str, list[str]] = {}
    out: set[str] = set()
    for motion in world.motions():
        if motion.verb == "stock":
            out.discard(motion.plate)
            put.setdefault(motion.place, []).append(motion.plate)
        if motion.verb == "grip" and motion.plate not in out:
            out.add(motion.plate)
            taken.setdefault(motion.place, []).append(motion.plate)
    counted: dict[str, int] = {}
    plates: dict[str, str] = {}
    for record in records:
        if record.head.type == LabwarePlaced.TYPE:
            event = decode(record.head.type, record.head.schema, record.payload)
            assert isinstance(event, LabwarePlaced)
            if event.on:
                plates[event.labware] = f"lid of {plates.get(event.on, '?')}"
                continue
            place = local(event.stack or event.station)
            number = counted.get(place, 0)
            counted[place] = number + 1
            known = (taken if event.stack else put).get(place, [])
            if number < len(known):
                plates[event.labware] = known[number]
    return plates
