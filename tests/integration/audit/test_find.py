"""The search index: what is found by which words, alike on both databases."""

from __future__ import annotations

import json
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from labos.audit import projector
from labos.audit.database import find_audit_file, open_audit
from labos.audit.find import LogPlace, SearchQuery, SearchResult, find
from labos.audit.find_process import Index
from labos.audit.query import open_asker
from labos.audit.words import join_words, words_of
from labos.cli.app import main
from labos.core.ids import LabId
from labos.core.labware import Sample, SamplesRegistered
from labos.errors import BadInput
from labos.store import open_store
from tests.integration.audit.logs import GrowingLog, project
from tests.support.audited import PLATE, SHEET
from tests.support.published import PICTURE, TITLE, publish_lab
from tests.unit.services.logbook import START_NS


def ask(url: str, words: str = "", **filters: Any) -> SearchResult:
    with open_asker(url) as asker:
        return find(asker, SearchQuery(words, **filters))


def names(url: str, words: str = "", **filters: Any) -> list[str]:
    return [entry.name for entry in ask(url, words, **filters).entries]


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def url(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """An index that was made in two halves of batches of 40 events."""
    monkeypatch.setattr(projector, "BATCH", 40)
    lite = f"sqlite:///{tmp_path / 'labos.db'}"
    where = lite if request.param == "sqlite" else request.getfixturevalue("postgres_url")
    records = publish_lab().records
    log = GrowingLog(records, len(records) // 2)
    made = open_audit(where)
    project(log, made)
    log.end = len(records)
    project(log, made)
    made.close()
    return where


def test_words_are_cut_alike_whatever_they_look_like() -> None:
    found = "cafe color picker r1 3 0 5 μl 1 2"
    assert " ".join(words_of("Café color_picker R1#3 0.5 µL ½")) == found
    assert join_words([{"a": [1.5, True, None]}, ("B7", "b7")]) == "a 1 5 b7"
    assert len(join_words([" ".join(map(str, range(2000)))]).split()) == 500


def test_words_find_what_has_them_all(url: str) -> None:
    (published,) = ask(url, "CAFE green").entries
    assert (published.kind, published.title, published.user) == ("publication", TITLE, "eve")
    assert published.name.startswith("E1@")
    assert published.keywords == ["green", "Colour mixing"]
    assert published.creators == ["eve", "0000-0002-1825-0097"]
    assert [file.sha256 for file in published.files] == [PICTURE["sha256"]]
    assert names(url, "128 mixing") == names(url, "plate.png", kind=("publication",)) == [published.name]
    assert names(url, "café blue") == []
    assert names(url, "gre") == []
    assert names(url, "gre*") == [published.name]
    assert names(url, "water") == ["R2#3", "P1/B7"]
    assert names(url, "volumes") == ["R2"], "the names of its payload"


def test_what_bears_the_words_as_its_name_comes_first(url: str) -> None:
    assert names(url, "r2")[0] == "R2"
    assert names(url, "e1")[0] == "E1"
    assert set(names(url, "E1", kind=("run",))) == {"R4"}


def test_each_kind_is_there_with_what_is_known_of_it(url: str) -> None:
    every = {(entry.kind, entry.name): entry for entry in ask(url, limit=100).entries}
    assert every["experiment", "E1"].status == "ended"
    assert every["experiment", "E1"].title == "Color_Picker"
    assert names(url, "decision") == ["E1"], "what the application noted"
    assert every["run", "R4"].experiment == "E1"
    assert {every["run", name].status for name in ("R1", "R2", "R3", "R4")} == {"completed"}
    assert every["result", "R2#3"].title == "absorbance of P1"
    assert every["sample", "P1/B7"].title == "water"
    image = every["image", PICTURE["sha256"]]
    assert (image.run, image.experiment, image.user) == ("R4", "E1", "eve")
    odd = next(entry for (kind, _), entry in every.items() if kind == "publication" and entry.title == "odd")
    assert odd.keywords == []


def test_filters_and_facets_count_what_fits(url: str) -> None:
    found = ask(url, facets=True, limit=2)
    assert len(found.entries) == 2
    counts = {facet: {v.value: v.count for v in values} for facet, values in found.facets.items()}
    assert sum(counts["kind"].values()) == found.total
    assert counts["kind"]["run"] == 4
    assert counts["user"]["bo"] == 1
    assert counts["month"] == {"2025-06": found.total}
    assert counts["keyword"] == {"Colour mixing": 1, "absorbance": 1, "green": 1}
    assert counts["workflow"]["Color_Picker"] == 3
    for facet in ("kind", "user", "keyword"):
        for value, count in counts[facet].items():
            assert ask(url, **{facet: (value,)}).total == count, (facet, value)
    assert ask(url, kind=("run", "result"), user=("ada",)).total == 3
    assert ask(url, workcell=("rpl",), run=("R4",)).total == counts["kind"]["image"] + 1
    day = START_NS + 86_400_000_000_000
    assert ask(url, since=day).total + ask(url, until=day).total == found.total
    assert names(url, limit=100)[2:5] == names(url, limit=3, offset=2)


def test_a_question_that_cannot_be_answered_says_why(url: str) -> None:
    for words, said in (("!?", "no word"), (" ".join(map(str, range(40))), "at most 30")):
        with pytest.raises(BadInput, match=said):
            ask(url, words)
    with pytest.raises(BadInput, match="publication"):
        ask(url, kind=("thing",))
    assert ask(url, """x' OR "1" AND NOT (a) NEAR b * ^ : & | ! \\ '' """).total == 0


def test_samples_of_a_new_sheet_take_the_place_of_the_old(tmp_path: Path) -> None:
    book = publish_lab()
    book.write([SamplesRegistered(PLATE, "", SHEET, 1, (Sample("A1", "ethanol", 5.0),))], "bo")
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    made = open_audit(url)
    project(GrowingLog(book.records), made)
    made.close()
    (old,) = ask(url, "water", kind=("sample",)).entries
    assert (old.name, old.status) == ("P1/B7", "replaced")
    assert names(url, "ethanol") == ["P1/A1"]


def test_the_index_agrees_with_its_rows_after_each_change(tmp_path: Path) -> None:
    """FTS5 compares its index with the table: rows that were replaced have left it."""
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    log = GrowingLog(publish_lab().records)
    for end in (*range(20, log.end, 37), log.end):
        log.end = end
        made = open_audit(url)
        project(log, made)
        made.close()
        lite = sqlite3.connect(find_audit_file(tmp_path / "labos.db"))
        lite.execute("INSERT INTO labos_entry_words (labos_entry_words, rank) VALUES ('integrity-check', 1)")
        lite.close()


def test_a_search_is_complete_while_events_are_written(tmp_path: Path) -> None:
    records = publish_lab().records
    half = len(records) // 2
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    store = open_store(url, home=tmp_path)
    head = store.append(store.claim(LabId(records[0].head.lab), "test", 30.0), records[:half])

    def write_the_rest() -> None:
        now = head
        for record in records[half:]:
            now = store.append(now, [record])

    index = Index(LogPlace(url, str(tmp_path / "blobs"), str(tmp_path)))
    found = [index.answer(SearchQuery())]
    with closing(store), ThreadPoolExecutor(1) as pool:
        writing = pool.submit(write_the_rest)
        while not writing.done():
            found.append(index.answer(SearchQuery()))
        writing.result()
    found.append(index.answer(SearchQuery()))
    assert {result.behind for result in found} == {0}
    positions = [result.position for result in found]
    assert positions == sorted(positions)
    assert (positions[0], positions[-1]) == (half, len(records))
    assert len(set(positions)) > 2, "no search came while the events were written"


def test_find_answers_at_the_shell_and_is_rebuilt_by_one_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "lab"
    publish_lab().save(home)
    monkeypatch.setenv("LABOS_HOME", str(home))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)

    def say(*words: str) -> str:
        assert main(list(words)) == 0
        return capsys.readouterr().out

    told = json.loads(say("find", "green", "--facets", "--json"))
    assert [entry["title"] for entry in told["entries"]] == [TITLE]
    assert told["facets"]["user"] == [{"value": "eve", "count": 1}]
    assert told["behind"] == 0
    shown = say("find", "--kind", "run", "--user", "ada", "--facets", "--last", "1")
    assert "1 to 1 of 2; the next ones: --offset 1" in shown
    assert "workflow:    cp_mixcolor 1, cp_newplate 1" in shown
    assert "No entry matches." in say("find", "nothing-like-it")
    assert "No entry matches." in say("find", "--since", "now")
    before = say("find", "--json", "--last", "200")
    say("audit", "rebuild")
    assert say("find", "--json", "--last", "200") == before
    assert main(["find", "!!"]) == 1
    assert "labos find color" in capsys.readouterr().err
