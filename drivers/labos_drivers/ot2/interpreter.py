"""Runs a protocol that was written as YAML. This whole file is sent to the robot, and after it the plan and
the values of the run. It uses only the Opentrons API.

A pipette without a tip picks one up before it works. It drops the tip after a transfer unless ``drop_tip`` is
false, at ``replace_tip``, and at the end of the protocol.
"""

from __future__ import annotations

from typing import Any

PLAN: dict[str, Any] = {}
LABOS: dict[str, Any] = {}


def run(protocol: Any) -> None:
    """Carry out the plan; the robot calls this function."""
    labware, modules = _load(protocol)
    pipettes = _pipettes(protocol, labware)
    for command in PLAN["commands"]:
        protocol.comment(command["name"])
        if "change_temp" in command:
            for module in modules:
                module.set_temperature(command["change_temp"])
        elif command.get("replace_tip"):
            _drop(pipettes)
        elif "reps" in command:
            for well in _wells(command["location"], labware):
                pipette = _pipette_for(command["mix_volume"], pipettes)
                _hold_tip(pipette)
                pipette.mix(command["reps"], command["mix_volume"], well)
        else:
            _transfer(command, labware, pipettes)
    _drop(pipettes)


def _load(protocol: Any) -> tuple[dict[str, Any], list[Any]]:
    """Load labware and modules; returns the labware by location and by alias, and the modules under it."""
    labware, modules = {}, []
    for item in PLAN["labware"]:
        where = str(item["location"])
        if item.get("module"):
            module = protocol.load_module(item["module"].lower(), where)
            modules.append(module)
            found = module.load_labware(item["name"])
        else:
            found = protocol.load_labware(item["name"], where)
        if item.get("offset"):
            x, y, z = item["offset"]
            found.set_offset(x=x, y=y, z=z)
        labware[where] = labware[item.get("alias") or where] = found
    return labware, modules


def _pipettes(protocol: Any, labware: dict[str, Any]) -> list[Any]:
    """Load the pipettes; returns them, the smallest first. Each takes tips from racks of its own size."""
    racks = list({id(rack): rack for rack in labware.values() if rack.is_tiprack}.values())
    found = []
    for item in PLAN["pipettes"]:
        pipette = protocol.load_instrument(item["name"], item["mount"])
        # A pipette of 20 µL uses tips of 20 µL; one of 300 µL uses tips of 300 µL or 200 µL.
        pipette.tip_racks = [
            rack for rack in racks if 0.5 < rack.wells()[0].max_volume / pipette.max_volume < 1.5
        ]
        found.append(pipette)
    return sorted(found, key=lambda pipette: pipette.max_volume)


def _transfer(command: dict[str, Any], labware: dict[str, Any], pipettes: list[Any]) -> None:
    sources = _wells(command["source"], labware)
    targets = _wells(command["destination"], labware)
    volumes = _value(command["volume"])
    volumes = volumes if isinstance(volumes, list) else [volumes]
    count = max(len(sources), len(targets), len(volumes))
    for many in (sources, targets, volumes):
        if len(many) not in (1, count):
            raise ValueError(f"{command['name']}: {len(many)} and {count} do not match")
    for number in range(count):
        source, target, volume = (
            many[number if len(many) > 1 else 0] for many in (sources, targets, volumes)
        )
        if volume <= 0:
            continue
        least = min(pipette.min_volume for pipette in pipettes)
        if volume < least:
            name = command["name"]
            raise ValueError(f"{name}: {volume} uL are less than any pipette here takes ({least} uL)")
        pipette = _pipette_for(volume, pipettes)
        _hold_tip(pipette)
        times = int(-(-volume // pipette.max_volume))
        for _ in range(times):
            pipette.aspirate(volume / times, source.bottom(command.get("aspirate_clearance", 1)))
            pipette.dispense(volume / times, target.bottom(command.get("dispense_clearance", 1)))
        if command.get("mix_cycles") and command.get("mix_volume"):
            pipette.mix(command["mix_cycles"], command["mix_volume"], target)
        if command.get("blow_out", True):
            pipette.blow_out(target.top())
        if command.get("drop_tip", True):
            pipette.drop_tip()


def _pipette_for(volume: float, pipettes: list[Any]) -> Any:
    """The smallest pipette that takes the volume at once; the largest if none does."""
    return next((pipette for pipette in pipettes if volume <= pipette.max_volume), pipettes[-1])


def _hold_tip(pipette: Any) -> None:
    if not pipette.has_tip:
        pipette.pick_up_tip()


def _drop(pipettes: list[Any]) -> None:
    for pipette in pipettes:
        if pipette.has_tip:
            pipette.drop_tip()


def _value(written: Any) -> Any:
    """The value of the run for ``payload.name``; anything else is returned unchanged."""
    if isinstance(written, str) and written.startswith("payload."):
        return LABOS[written[len("payload.") :]]
    return written


def _wells(written: Any, labware: dict[str, Any]) -> list[Any]:
    """The wells of ``dest:A1``, ``dest:[A1, A2]``, ``dest:[1...12]`` (columns; their wells in row A), or of a
    list of such places. A place without labware is a well of ``dest``."""
    value = _value(written)
    found: list[Any] = []
    for place in value if isinstance(value, list) else [value]:
        name, colon, wells = str(place).rpartition(":")
        rack = labware[name if colon else "dest"]
        for well in wells.strip("[]").split(","):
            first, dots, last = well.strip().partition("...")
            if dots:
                found.extend(rack[f"A{column}"] for column in range(int(first), int(last) + 1))
            else:
                found.append(rack[f"A{first}" if first.isdigit() else first])
    return found
