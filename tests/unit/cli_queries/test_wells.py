"""Wells are listed as a plate has them: A1, A2, A10, B1."""

from __future__ import annotations

import json
from pathlib import Path

from labos.core.experiments import ExperimentNoted, ExperimentStarted
from labos.core.ids import ExperimentId, LabwareId, ModuleName
from labos.core.labware import LabwareChanged, Sample, SamplesRegistered
from labos.core.resources import LevelSet
from tests.unit.cli_queries.conftest import Ask
from tests.unit.cli_queries.test_queries import append

SHUFFLED = ("B1", "A10", "A2", "A1")
IN_ORDER = ["A1", "A2", "A10", "B1"]


def list_wells(text: str) -> list[str]:
    """The wells among the first words of lines."""
    return [words[0] for words in map(str.split, text.splitlines()) if words and words[0] in SHUFFLED]


def test_samples(ask: Ask, home: Path) -> None:
    samples = tuple(Sample(well, f"code-{well}", 5.0) for well in SHUFFLED)
    append(home, SamplesRegistered(LabwareId("P1"), "", "d", len(samples), samples))
    assert list_wells(ask("samples", "show", "P1").stdout) == IN_ORDER
    rows = ask("samples", "show", "P1", "--csv").stdout.splitlines()[1:]
    assert [row.split(",")[1] for row in rows] == IN_ORDER
    facts = json.loads(ask("samples", "show", "P1", "--json").stdout)
    assert [sample["well"] for sample in facts["samples"]] == IN_ORDER


def test_labware_and_its_story(ask: Ask, home: Path) -> None:
    append(home, LabwareChanged(LabwareId("P1"), "", "colours", dict.fromkeys(SHUFFLED, 1)))
    order = '{"A1": 1, "A2": 1, "A10": 1, "B1": 1}'
    told = ask("labware", "P1").stdout
    assert told.count(order) == 2, "as a variable, and in what became of it"
    assert list(json.loads(ask("labware", "P1", "--json").stdout)["variables"]["colours"]) == IN_ORDER
    assert order in ask("log", "--last", "1").stdout


def test_resources_of_a_module(ask: Ask, home: Path) -> None:
    module = ModuleName("rpl/ot2_pcr_alpha")
    append(home, *(LevelSet(module, well, 1.0, 2.0) for well in SHUFFLED))
    found = ask("inventory").stdout
    wells = [words[1] for words in map(str.split, found.splitlines()) if words[1:] and words[1] in SHUFFLED]
    assert wells == IN_ORDER
    plain = json.loads(ask("inventory", "--json").stdout)["resources"]
    assert [one["resource"] for one in plain if one["resource"] in SHUFFLED] == IN_ORDER


def test_objects_in_json_are_sorted_by_name_but_for_wells(ask: Ask, home: Path) -> None:
    append(home, ExperimentStarted(ExperimentId("E1"), "colours", "bo"))
    append(home, ExperimentNoted(ExperimentId("E1"), "decision", "x", dict.fromkeys(SHUFFLED, 1)))
    assert '{"A1": 1, "A2": 1, "A10": 1, "B1": 1}' in ask("log", "--last", "1").stdout
    keys = list(json.loads(ask("experiments", "--json").stdout)[0])
    assert keys == sorted(keys)
