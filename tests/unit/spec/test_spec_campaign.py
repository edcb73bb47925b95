"""Campaign files: every way to write rows, and every fault at its place."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from labos.core.campaigns import Budget
from labos.spec import SpecErrors
from labos.spec.campaign import CampaignSource, parse_campaign
from labos.spec.shares import parse_shares

HEAD = "labos: 1\ncampaign: screen\nworkflow: pcr\n"


def campaign(rest: str, **files: str) -> CampaignSource:
    tables = {name.replace("_", "."): text.encode() for name, text in files.items()}
    return parse_campaign(HEAD + rest, "c.yaml", tables)


def payloads(rest: str, **files: str) -> list[dict[str, Any]]:
    return [line.payload for line in campaign(rest, **files).lines]


def faults(rest: str, **files: str) -> str:
    with pytest.raises(SpecErrors) as errors:
        campaign(rest, **files)
    return str(errors.value)


def test_a_csv_table() -> None:
    found = payloads("payload: {b: {k: 0}}\nrows: {table: r.csv}", r_csv="a;b.c\n1;x\n\n2.5;[1, 2]\ntrue;\n")
    assert found == [
        {"a": 1, "b": {"c": "x", "k": 0}},
        {"a": 2.5, "b": {"c": [1, 2], "k": 0}},
        {"a": True, "b": {"k": 0}},
    ]


@pytest.mark.parametrize("name", ["r.yaml", "r.json"])
def test_a_list_of_tables_in_a_file(name: str) -> None:
    text = '[{"a.b": 1}, {"a.b": 2}]'
    source = parse_campaign(f"{HEAD}rows: {{table: {name}}}", "c.yaml", {name: text.encode()})
    assert [line.payload for line in source.lines] == [{"a": {"b": 1}}, {"a": {"b": 2}}]


def test_lists_grids_and_columns() -> None:
    assert payloads("rows: {list: [{a: 1}, {a: 2}]}") == [{"a": 1}, {"a": 2}]
    grid = payloads("rows: {grid: {a: [1, 2], b: [x, y, z]}}")
    assert [(row["a"], row["b"]) for row in grid] == list(itertools.product([1, 2], "xyz"))
    assert payloads("rows: {zip: {a: [1, 2], b: [x, y]}}") == [{"a": 1, "b": "x"}, {"a": 2, "b": "y"}]


def test_a_latin_hypercube_meets_each_slice_once_and_is_the_same_again() -> None:
    text = (
        "rows: {latin_hypercube: {samples: 10, seed: %d, spans: {x: {from: 0, to: 1}, "
        "n: {from: 1, to: 10, whole: true}}}}"
    )
    rows = payloads(text % 7)
    assert sorted(int(row["x"] * 10) for row in rows) == list(range(10))
    assert sorted(row["n"] for row in rows) == list(range(1, 11))
    assert rows == payloads(text % 7) != payloads(text % 8)


def test_its_terms() -> None:
    terms = campaign(
        "rows: {list: [{a: 1}]}\npriority: 3\ntags: [x]\nuntil: steps.Read.result.od > 1\n"
        "budget: {runs: 5, lab_time: 2 h, consumables: {tips: 8}}\non_failure: {stop_after: 2}\n"
    ).terms
    assert (terms.priority, terms.tags, terms.stop_after) == (3, ("x",), 2)
    assert terms.budget == Budget(5, 7200.0, {"tips": 8.0})
    assert terms.until is not None
    assert campaign("rows: {list: [{a: 1}]}\non_failure: stop").terms.stop_after == 1


@pytest.mark.parametrize(
    ("rest", "table", "said"),
    [
        ("rows: {}", "", "c.yaml:4:7: rows: The source of the rows is missing."),
        ("rows: {grid: {a: [1]}, zip: {a: [1]}}", "", "Rows come from grid and zip."),
        ("rows: {table: none.csv}", "", "c.yaml:4:15: rows.table: The table 'none.csv' cannot be found."),
        ("rows: {zip: {a: [1], b: [1, 2]}}", "", "The columns differ in length (a: 1, b: 2)."),
        ("rows: {table: r.csv}", "a,b\n1,2\n1\n", "r.csv:3:2: Row 2 has 1 fields; the first line names 2."),
        ("rows: {table: r.csv}", "a,a\n1,2\n", "r.csv:1:2: The column 'a' is there twice."),
        ("rows: {table: r.csv}", "a,\n1,2\n", "r.csv:1:2: A column has no name."),
        ("rows: {table: r.csv}", "a,a.b\n1,2\n", "r.csv:2:1: a.b: Row 1: 'a.b' leads into 'a', which is a"),
        ("rows: {table: r.csv}", "a\n", "The campaign has no rows."),
        ("rows: {list: [{a: 1}]}\nuntil: od > 1", "", "c.yaml:5:8: until:"),
        ("rows: {list: [{a: 1}]}\nuntil: 1 > 0", "", "uses no result"),
        ("rows: {list: [{a: 1}]}\nuntil: steps.Read.od > 0", "", "is not a result of a step"),
        ("rows: {list: [{a: 1}]}\nbudgets: 3", "", "Did you mean 'budget'?"),
        ("rows: {grid: {a: %s, b: %s}}" % ((list(range(400)),) * 2), "", "more than 100000 rows"),
    ],
)
def test_faults_at_their_places(rest: str, table: str, said: str) -> None:
    assert said in faults(rest, r_csv=table)


def test_all_rows_that_do_not_fit_are_told_at_once() -> None:
    told = faults("rows: {table: r.csv}", r_csv="a,b\n1\n1,2\n1,2,3\n")
    assert "r.csv:2:2" in told
    assert "r.csv:4:3" in told


def test_shares() -> None:
    found = parse_shares(
        "labos: 1\ngroups:\n"
        "  chem: {weight: 2.0, members: {ada: {}, bo: {weight: 3.0}}, quota: {running: 2}}\n"
        "users: {eve: {quota: {lab_hours: 5.0}}}\n"
    )
    (chem,) = found.groups
    assert (chem.weight, chem.members["bo"].weight, chem.quota.running) == (2.0, 3.0, 2)
    assert found.users["eve"].quota.lab_hours == 5.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("groups: {a: {members: {x: {}}}, b: {members: {x: {}}}}", "'x' is in the group 'a' already."),
        ("groups: {a: {members: {x: {}}}}\nusers: {x: {}}", "'x' is in the group 'a'"),
        ("users: {x: {weight: 0.0}}", "users.x.weight"),
        ("group: {}", "Did you mean 'groups'?"),
    ],
)
def test_faults_in_shares(text: str, said: str) -> None:
    with pytest.raises(SpecErrors) as error:
        parse_shares(f"labos: 1\n{text}\n", "s.yaml")
    assert said in str(error.value)
