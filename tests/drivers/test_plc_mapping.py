"""The mapping of a PLC: what follows from it, and what is said of its slips."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import descriptions
from labos.core.effects import Sets
from labos.errors import BadInput, DeviceError
from labos.node import Setup
from labos.node.mapping import read_table
from labos.spec import load_workcell, parse_workcell
from labos.spec.about import find_description
from labos.spec.source import make_plain, read
from labos_drivers.plc.about import TABLE, describe
from labos_drivers.plc.driver import PlcDriver
from labos_drivers.plc.interface import HATCH, Plc
from labos_drivers.plc.mapping import Condition, PlcMapping, Point
from labos_drivers.plc.values import decode, encode, is_met, is_undecided

WORKCELL = (
    "labos: 1\nname: lab\nmodules:\n  - name: hatch\n    driver: plc\n    config:\n      address: 10.0.7.5\n"
)


def hatch() -> str:
    return HATCH.read_text("utf-8")


def test_what_a_module_offers_follows_from_its_mapping(tmp_path: Path) -> None:
    (tmp_path / "hatch.yaml").write_text(hatch())
    (tmp_path / "lab.yaml").write_text(WORKCELL + "      plc: hatch.yaml\n")
    cell = load_workcell(tmp_path / "lab.yaml", descriptions())
    (module,) = cell.workcell.modules
    about = find_description(module, {})
    assert about is not None
    close = about.action("close")
    assert close is not None
    assert [(a.name, a.unit, a.minimum, a.maximum, a.default) for a in close.args] == [
        ("speed", "mm/s", 10.0, 100.0, 50.0)
    ]
    assert close.effects == (Sets("module", "door", "closed"),)
    (query,) = [action for action in about.actions if not action.exclusive]
    assert (query.name, query.result) == ("read_temperature", "float")
    (station,) = cell.workcell.stations
    assert (station.name, station.access) == ("lab/hatch.nest", {"door": "open"})
    # The node is told the table itself, and makes of it what the lab was told.
    told = module.config["config"]["plc"]
    assert told == make_plain(read(HATCH).data)
    own = Plc.for_config({"plc": told}).describe()
    assert own.actions[:-1] == about.actions[: len(own.actions) - 1]


@pytest.mark.parametrize(
    ("condition", "value", "holds", "is_open"),
    [
        ({"is": [2, 3]}, 7, False, False),
        ({"is": [2, 3], "not": [0, 1]}, 3, True, False),
        ({"is": [2, 3], "not": [0, 1]}, 1, False, False),
        ({"is": [2, 3], "not": [0, 1]}, 7, False, True),
        ({"minimum": 2, "not": 0}, 1, False, True),
    ],
)
def test_a_value_that_says_neither_leaves_it_open(
    condition: dict[str, Any], value: int, holds: bool, is_open: bool
) -> None:
    meant = Condition.model_validate({"point": "mode", **condition})
    assert (is_met(meant, value), is_undecided(meant, value)) == (holds, is_open)


@pytest.mark.parametrize(("mode", "busy"), [(0, False), (2, True), (7, True)])
def test_a_mode_that_is_not_known_is_no_rest(mode: int, busy: bool) -> None:
    table = make_plain(read(HATCH).data) | {"state": {"busy": {"point": "fault", "is": 2, "not": 0}}}

    class Hatch(PlcDriver):
        mapping = PlcMapping.model_validate(table)

    driver = Hatch(Setup("hatch", "lab", {}), "127.0.0.1:1")
    assert driver._is_busy({"fault": mode}) is busy


def test_a_changed_mapping_is_another_workcell(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text(WORKCELL + "      plc: hatch.yaml\n")
    digests = set()
    for duration in ("8 s", "9 s"):
        (tmp_path / "hatch.yaml").write_text(hatch().replace("duration: 8 s", f"duration: {duration}"))
        digests.add(load_workcell(tmp_path / "lab.yaml", descriptions()).workcell.digest)
    assert len(digests) == 2


SLIPS = {
    "no such point": ("done: is_open", "done: is_opened", "There is no point 'is_opened'. Did you mean"),
    "no such key": (
        "busy: is_moving",
        "buzy: is_moving",
        "The key 'buzy' is not known here. Did you mean 'busy'",
    ),
    "read only": (
        "reset: reset",
        "reset: plate",
        "plate cannot be written. Use a coil or a holding register.",
    ),
    "two places": (
        "{coil: 0}",
        "{coil: 0, holding: 3}",
        "A point is in one of coil, discrete, input, holding",
    ),
    "no type of a coil": (
        "{coil: 1}",
        "{coil: 1, type: int16}",
        "A coil is a bit and cannot have another type",
    ),
    "out of limits": (
        'value: 1}, {point: speed, value: "{speed}"}',
        "value: 1}, {point: speed, value: 200}",
        "cannot be 200",
    ),
    "no argument": (
        'value: 1}, {point: speed, value: "{speed}"}',
        'value: "fast"}',
        "'fast' is neither a value nor an",
    ),
    "not a bit": (
        "busy: is_moving",
        "busy: fault",
        "fault is a number, but the condition has nothing to compare it with.",
    ),
    "no variable": (
        "sets: {door: open}",
        "sets: {dor: open}",
        "There is no variable 'dor'. Did you mean 'door'?",
    ),
    "never so": (
        "sets: {door: open}",
        "sets: {door: on}",
        "door is never True. Write one of open, closed, between. YAML",
    ),
    "no station": ("  nest: plate", "  nset: plate", "There is no station 'nset'. Did you mean 'nest'?"),
    "start beside a handshake": (
        "    done: is_open\n",
        "    done: is_open\n    start: reset\n",
        "With a handshake",
    ),
    "no number": ("number: number,", "number: speed,", "speed cannot hold the number of an attempt."),
    "no effect": (
        "    sets: {door: open}\n",
        "    sets: {door: open}\n    effects: [{moves: {}}]\n",
        "the effect 'moves'",
    ),
    "not the number of a fault": ("    1: {why", "    one: {why", "'one' is not the number of a fault."),
}
"""By what is wrong: what is replaced by what, and what is said of it."""


@pytest.mark.parametrize("slip", SLIPS)
def test_slips_are_told_with_their_place(slip: str, tmp_path: Path) -> None:
    good, bad, words = SLIPS[slip]
    text = hatch()
    assert good in text
    path = tmp_path / "hatch.yaml"
    path.write_text(text.replace(good, bad, 1))
    (tmp_path / "lab.yaml").write_text(WORKCELL + "      plc: hatch.yaml\n")
    for read_it in (
        lambda: load_workcell(tmp_path / "lab.yaml", descriptions()),
        lambda: read_table(TABLE, str(path)),
    ):
        with pytest.raises(BadInput) as told:
            read_it()
        first = str(told.value).splitlines()[0]
        assert words in first
        place = re.match(rf"{re.escape(str(path))}:(\d+):(\d+): ", first)
        assert place is not None
        # The line that is named is the changed one, or one that speaks of the same thing.
        changed = next(
            n
            for n, (was, is_) in enumerate(
                itertools.zip_longest(text.splitlines(), path.read_text().splitlines()), 1
            )
            if was != is_
        )
        assert abs(int(place[1]) - changed) <= 6


def test_a_table_in_the_workcell_file_itself() -> None:
    inside = "      plc:\n" + "".join(f"        {line}\n" for line in hatch().splitlines())
    cell = parse_workcell(WORKCELL + inside, descriptions(), "lab.yaml")
    assert [m.name for m in cell.workcell.modules] == ["lab/hatch"]
    with pytest.raises(BadInput, match=r"lab\.yaml:\d+:\d+: .*There is no point 'is_opened'"):
        parse_workcell(
            WORKCELL + inside.replace("done: is_open", "done: is_opened"), descriptions(), "lab.yaml"
        )


def test_a_module_without_a_mapping() -> None:
    with pytest.raises(BadInput, match="The driver plc needs `plc`"):
        parse_workcell(WORKCELL, descriptions(), "lab.yaml")
    with pytest.raises(
        BadInput, match=r"lab\.yaml:8:12: .*cannot be found: this workcell was not loaded from"
    ):
        parse_workcell(WORKCELL + "      plc: hatch.yaml\n", descriptions(), "lab.yaml")
    with pytest.raises(BadInput, match="neither a table nor the name of a file"):
        read_table(TABLE, 7)


@pytest.mark.parametrize(
    ("point", "value", "words"),
    [
        ({"holding": 0}, 65535, [0xFFFF]),
        ({"holding": 0, "type": "int16"}, -2, [0xFFFE]),
        ({"holding": 0, "scale": 0.1}, 12.5, [125]),
        ({"holding": 0, "type": "int16", "scale": 0.5, "offset": -40.0}, -45.0, [0xFFF6]),
        ({"holding": 0, "type": "uint32"}, 0x12345678, [0x1234, 0x5678]),
        ({"holding": 0, "type": "uint32", "word_order": "little"}, 0x12345678, [0x5678, 0x1234]),
        ({"holding": 0, "type": "float32"}, 1.5, [0x3FC0, 0]),
        ({"holding": 0, "type": "float64", "word_order": "little"}, -2.0, [0, 0, 0, 0xC000]),
        ({"holding": 0, "type": "int64"}, -1, [0xFFFF] * 4),
        ({"coil": 0}, True, [1]),
    ],
)
def test_values_in_registers(point: dict[str, Any], value: Any, words: list[int]) -> None:
    told = Point.model_validate(point)
    assert encode("it", told, value) == words
    back = decode(told, words)
    assert back == pytest.approx(value)
    assert isinstance(back, type(value))


def test_a_bit_of_a_register() -> None:
    point = Point.model_validate({"input": 3, "bit": 9})
    assert [decode(point, [word]) for word in (0x0200, 0xFDFF)] == [True, False]


@pytest.mark.parametrize("value", [70000, -1])
def test_what_does_not_fit_is_refused(value: int) -> None:
    with pytest.raises(DeviceError, match="does not fit into uint16") as told:
        encode("it", Point.model_validate({"holding": 0}), value)
    assert told.value.effects == "none"


def test_noise_is_no_number() -> None:
    with pytest.raises(DeviceError, match="which is not a number"):
        decode(Point.model_validate({"input": 0, "type": "float32"}), [0x7FC0, 0])


def test_the_hatch_describes_itself() -> None:
    assert [a.name for a in describe(read_table(TABLE, str(HATCH))).actions] == [
        *("open", "close", "read_temperature", "reset")
    ]
