"""Workcell files: stations, drivers, stock, and what can be wrong with them."""

from __future__ import annotations

import msgspec
import pytest
from spec_bench import BENCH, DESCRIPTIONS, PAPER, WORKCELL, where

from labos.bootstrap import descriptions as installed
from labos.core.ids import StationName, local
from labos.errors import SpecError
from labos.spec import (
    Stock,
    load_workcell,
    parse_source,
    parse_workcell,
    resolve_station,
    validate_workcell,
)
from labos.spec.findings import SpecErrors

STATIONS = {station.name: station for station in BENCH.workcell.stations}
MODULES = {module.name: module for module in BENCH.workcell.modules}


def test_the_papers_workcell_loads_verbatim() -> None:
    loaded = load_workcell(PAPER / "rpl_modular_workcell.yaml", DESCRIPTIONS)
    [finding] = loaded.findings
    assert (finding.severity, finding.line, finding.column) == ("warning", 69, 27)
    assert "8 numbers" in finding.message
    assert len(loaded.workcell.modules) == 14
    drivers = {module.name.rpartition("/")[2]: module.driver for module in loaded.workcell.modules}
    assert drivers["sealer"] == "sealer"
    assert drivers["biometra_192"] == "cycler"
    stations = {station.name: station for station in loaded.workcell.stations}
    trash = stations[StationName("RPL_Modular_workcell/wc.trash")]
    assert (trash.kind, trash.module, trash.capacity) == ("waste", "", 50)
    cooler = stations[StationName("RPL_Modular_workcell/ot2_pcr_alpha.deck1_cooler")]
    assert cooler.reach == {"RPL_Modular_workcell/pf400": ()}
    assert cooler.kind == "deck"
    assert not any("workcell" in arm.split("/")[1] for s in stations.values() for arm in s.reach)
    arm = next(module for module in loaded.workcell.modules if module.driver == "arm")
    assert arm.config["poses"]["camera_module.plate_station"][0] == 90.597
    assert arm.config["config"]["ros_node_address"] == "/std_ns/pf400Node"
    assert {(s.labware, s.count) for s in loaded.bench.stock} == {("plate96", 20)}


def test_stations_of_our_own_form() -> None:
    deck = STATIONS[StationName("wc1/ot2.deck2")]
    assert deck.reach == {"wc1/arm": ("narrow",)}
    assert deck.claim == "wc1/ot2"
    assert STATIONS[StationName("wc1/stack.tower1")].claim == ""
    assert STATIONS[StationName("wc1/stack.exchange")].claim == ""
    assert STATIONS[StationName("wc1/cycler.default")].access == {"lid": "open"}
    assert STATIONS[StationName("wc1/wc.hotel")].capacity == 2
    assert MODULES["wc1/arm"].regrip == "wc1/wc.regrip"  # type: ignore[index]
    assert MODULES["wc1/arm"].config["config"]["waste"] == ["wc.trash"]  # type: ignore[index]
    assert BENCH.bench.stock == (Stock(StationName("wc1/stack.tower1"), "plate96", 20),)


@pytest.mark.parametrize(
    ("text", "module", "name"),
    [
        ("sealer.default", "", "wc1/sealer.default"),
        ("sealer.positions.default", "", "wc1/sealer.default"),
        ("wc1/sealer.default", "", "wc1/sealer.default"),
        ("Sealer.Default", "", "wc1/sealer.default"),
        ("sealer.nest", "", "wc1/sealer.default"),
        ("sealer", "", "wc1/sealer.default"),
        ("tower2", "stack", "wc1/stack.tower2"),
        ("tower2", "", "wc1/stack.tower2"),
        ("default", "cycler", "wc1/cycler.default"),
        ("gripper", "arm", "wc1/arm.gripper"),
        ("trash", "", "wc1/wc.trash"),
    ],
)
def test_a_place_may_be_written_in_many_ways(text: str, module: str, name: str) -> None:
    assert resolve_station(BENCH.workcell, text, module) == name


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sealer.defualt", "Did you mean 'sealer.default'"),
        ("default", "is ambiguous: cycler.default, sealer.default"),
        ("other/sealer.default", "is not in the workcell"),
        ("ot2", "no station"),
        ("", "no station"),
    ],
)
def test_an_unknown_place_says_what_is_near(text: str, says: str) -> None:
    with pytest.raises(SpecError) as caught:
        resolve_station(BENCH.workcell, text)
    assert says in str(caught.value)


def change_text(old: str, new: str) -> str:
    assert old in WORKCELL
    return WORKCELL.replace(old, new)


@pytest.mark.parametrize(
    ("text", "line", "column", "field", "says"),
    [
        (change_text("name: wc1", "nmae: wc1"), 2, 1, "nmae", "Did you mean 'name'"),
        (change_text("name: wc1", "name: a/b"), 2, 7, "name", "cannot be a name"),
        (change_text("labos: 1", "labos: 2"), 1, 8, "labos", "Write 1"),
        (change_text("name: sealer, model", "name: sealer, modle"), 6, 20, "modules[2].modle", "'model'"),
        (change_text("A4S_sealer", "A5S_sealer"), 6, 27, "modules[2].model", "Did you mean 'A4S_sealer'"),
        (change_text("model: A4S_sealer", "driver: seeler"), 6, 28, "modules[2].driver", "'sealer'"),
        (change_text("name: sealer", "name: arm"), 6, 12, "modules[2].name", "twice"),
        (change_text("{name: cam, model: camera (logitech)}", "{name: cam}"), 9, 5, "modules[5]", "no model"),
        (change_text("kind: waste", "kind: waist"), 11, 20, "stations.wc.trash.kind", "choices"),
        (change_text("capacity: 5", "capacity: 0"), 11, 37, "stations.wc.trash.capacity", "at least 1"),
        (
            change_text("capacity: 5", "capacity: five"),
            11,
            37,
            "stations.wc.trash.capacity",
            "a whole number",
        ),
        (change_text("capacity: 5", "capcity: 5"), 11, 27, "stations.wc.trash.capcity", "'capacity'"),
        (change_text("{arm: [narrow]}", "{amr: [narrow]}"), 15, 23, "stations.ot2.deck2.reach.amr", "'arm'"),
        (change_text("  wc.pcr: {k", "  pcr: {k"), 13, 3, "stations.pcr", "cannot be a station"),
        (change_text("    sealer.default:", "    sealer.defualt:"), 19, 5, None, "'sealer.default'"),
        (change_text("  arm:\n", "  amr:\n"), 17, 3, "locations.amr", "not a module"),
        (change_text("wc.trash: [1, 2]", "wc.trash: [1, a]"), 22, 19, "locations.arm.wc.trash[1]", "number"),
        (change_text("{plate96: 20}", "{plate96: 21}"), 27, 17, "stock.stack.tower1", "holds 20"),
        (change_text("stack.tower1: {p", "stack.tower9: {p"), 27, 3, "stock.stack.tower9", "'stack.tower"),
        (
            change_text("stack.tower1: {plate96: 20}", "wc.pcr:  {plate96: 1}"),
            27,
            13,
            "stock.wc.pcr.plate96",
            "accept",
        ),
        (change_text("regrip: wc.regrip", "regrip: wc.rigrep"), 5, 39, "modules[1].regrip", "'wc.regrip'"),
        (change_text("A4S_sealer}", "A4S_sealer, resources: {foli: 5}}"), 6, 51, None, "'foil'"),
        (change_text("A4S_sealer}", "A4S_sealer, coordinates: [1]}"), 6, 52, None, "seven numbers"),
        ("labos: 1\nname: x\n", 1, 1, "modules", "'modules' is missing"),
        ("labos: 1\nname: x\nmodules: []\n", 3, 10, "modules", "at least 1"),
        ("name: x\nconfig: 5\nmodules: []\n", 2, 9, "config", "table"),
        ("name: x\n", 1, 1, "modules", "is missing"),
        ("workcell_nodes: {a: b}\n", 1, 21, "workcell_nodes.a", "no address"),
    ],
)
def test_faults(text: str, line: int, column: int, field: str | None, says: str) -> None:
    findings = validate_workcell(parse_source(text, "wc.yaml"), DESCRIPTIONS)
    errors = [finding for finding in findings if finding.severity == "error"]
    fault = errors[0]
    assert says in f"{fault.message} {fault.remedy}"
    assert (*where(fault), fault.file) == (line, column, "wc.yaml")
    if field is not None:
        assert fault.field == field
    assert all(error.remedy for error in errors)


def test_a_model_that_several_drivers_serve_needs_a_driver() -> None:
    other = msgspec.structs.replace(DESCRIPTIONS["sealer"], driver="other_sealer")
    known = {**DESCRIPTIONS, "other_sealer": other}
    (fault,) = validate_workcell(parse_source(WORKCELL, "wc.yaml"), known)
    assert fault.severity == "error"
    assert fault.message == "The model 'A4S_sealer' has several drivers: sealer, other_sealer."
    assert "driver: sealer" in fault.remedy
    chosen = change_text("name: sealer, model: A4S_sealer", "name: sealer, driver: other_sealer")
    modules = {m.name: m for m in parse_workcell(chosen, known).workcell.modules}
    assert modules["wc1/sealer"].driver == "other_sealer"  # type: ignore[index]


def test_all_faults_are_told_at_once() -> None:
    text = WORKCELL.replace("waste,", "waist,").replace("capacity: 2", "capacity: two")
    assert len(validate_workcell(parse_source(text), DESCRIPTIONS)) == 2


def test_relatives_of_the_papers_dialect() -> None:
    text = """\
config: {ros_namespace: x}
modules:
  - name: sealer
    type: wei_ros_node
    positions: {default: [1, 2], spare: []}
  - {name: pf400, model: PF400, active: True, checks: x}
  - {name: robot, model: unheard_of}
  - {name: peeler, model: brooks_xpeel, active: false}
locations:
  pf400:
    sealer.default: [1, 2]
    peeler.default: [1, 2]
    elsewhere.nest: [1, 2]
    wc.trash: "Stack1"
  ghost: {a.b: "Stack1"}
"""
    loaded = parse_workcell(text, DESCRIPTIONS, "folder/old.yaml")
    assert loaded.workcell.name == "old"
    assert [module.name for module in loaded.workcell.modules] == ["old/sealer", "old/pf400"]
    names = [station.name for station in loaded.workcell.stations]
    assert "old/sealer.spare" in names
    assert "old/elsewhere.nest" in names
    assert "old/peeler.default" not in names
    told = {(finding.line, finding.column): finding.message for finding in loaded.findings}
    assert "left out" in told[7, 26]
    assert "'checks'" in told[6, 47]
    assert "not a module of this workcell" in told[13, 5]
    assert "'ghost', which is not a module of this workcell" in told[15, 3]
    pf400 = loaded.workcell.modules[1].config
    assert pf400["config"]["representations"] == {"wc.trash": "Stack1"}
    assert pf400["poses"]["wc.trash"] == []
    assert all(finding.severity == "warning" for finding in loaded.findings)


def test_zones_of_stations_and_modules() -> None:
    loaded = parse_workcell(
        """
labos: 1
name: wc1
modules:
  - {name: arm, model: arm}
  - {name: ot2, driver: handler, zone: table}
stations:
  wc.a: {zone: table}
  ot2.deck2: {zone: table}
""",
        DESCRIPTIONS,
    ).workcell
    zones = {station.name: station.zone for station in loaded.stations if station.zone}
    assert zones == {"wc1/wc.a": "wc1/table", "wc1/ot2.deck2": "wc1/table"}
    assert {module.name: module.zone for module in loaded.modules} == {"wc1/arm": "", "wc1/ot2": "wc1/table"}


@pytest.mark.parametrize(
    ("entry", "claim"),
    [("{}", "wc1/ot2"), ("{claim: false}", ""), ("{independent: true}", ""), ("{claim: true}", "wc1/ot2")],
)
def test_a_deck_has_one_claim_unless_its_slots_are_independent(entry: str, claim: str) -> None:
    text = "labos: 1\nname: wc1\nmodules:\n  - {name: ot2, driver: handler}\nstations:\n"
    loaded = parse_workcell(f"{text}  ot2.deck2: {entry}\n", DESCRIPTIONS).workcell
    assert {s.name: s.claim for s in loaded.stations}[StationName("wc1/ot2.deck2")] == claim


def test_a_station_cannot_claim_and_be_independent() -> None:
    text = "labos: 1\nname: wc1\nmodules:\n  - {name: ot2, driver: handler}\nstations:\n"
    with pytest.raises(SpecErrors, match="cannot both claim"):
        parse_workcell(f"{text}  ot2.deck2: {{claim: true, independent: true}}\n", DESCRIPTIONS)


OBSERVED = """\
labos: 1
name: corner
modules:
  - {name: arm, model: pf400}
  - {name: eye, model: camera, config: {observes: [wc.z]}}
stations:
  wc.z: {}
  wc.a: {observer: eye}
  wc.b: {observer: eye, verify: on_doubt}
  wc.c: {observer: eye, verify: never}
  eye.plate_station: {observer: eye}
"""


def test_observers_are_told_what_they_look_at() -> None:
    loaded = parse_workcell(OBSERVED, installed())
    known = {local(s.name): (local(s.observer), s.verify) for s in loaded.workcell.stations if s.observer}
    assert known == {
        "wc.a": ("eye", "always"),
        "wc.b": ("eye", "on_doubt"),
        "wc.c": ("eye", "never"),
        "eye.plate_station": ("eye", "always"),
    }
    eye = next(m for m in loaded.workcell.modules if local(m.name) == "eye")
    assert eye.config["config"]["observes"] == ["wc.z", "wc.a", "wc.b"]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("wc.a: {observer: eys}", "'eys' is not a module of this workcell. Did you mean 'eye'?"),
        ("wc.a: {verify: always}", "'wc.a' has a time of observation, but no observer."),
        ("wc.a: {observer: eye, verify: sometimes}", "sometimes"),
        ("wc.trash: {observer: eye}", "Labware in the waste 'wc.trash' is off the bench"),
    ],
)
def test_what_is_wrong_with_an_observer(line: str, says: str) -> None:
    text = OBSERVED.partition("stations:")[0] + f"stations:\n  {line}\n"
    findings = validate_workcell(parse_source(text), installed())
    assert any(says in f"{f.message} {f.remedy}" for f in findings), findings
    assert all(f.line == 7 for f in findings)
