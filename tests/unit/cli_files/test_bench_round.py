"""What a person writes on a round of the bench, and how it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from labos.cli._bench_round import describe_recorded, parse_options, read_file, read_words, say
from labos.errors import BadInput


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("empty", []),
        ("", []),
        ("as recorded", None),
        ("As Recorded", None),
        ("=", None),
        ("P7", ["P7"]),
        ("P7+P8, plate96", ["P7+P8", "plate96"]),
        ("3xplate96", ["plate96"] * 3),
        ("x1plate", ["x1plate"]),
        ("2", ["labware", "labware"]),
    ],
)
def test_words_of_a_station(text: str, words: list[str] | None) -> None:
    assert read_words(text, "a") == words


def test_a_file_and_options_say_the_same(tmp_path: Path) -> None:
    file = tmp_path / "bench.yaml"
    file.write_text("a: P7\nb: [P1, 2xplate96]\nc:\nwc.trash: 3\nd: as recorded\nrest: as recorded\n")
    told = {"a": ["P7"], "b": ["P1", "plate96", "plate96"], "c": [], "wc.trash": ["labware"] * 3}
    assert read_file(str(file)) == {**told, "d": None, "rest": None}
    options = ("a=P7", "b=P1,2xplate96", "c=", "wc.trash=3", "d==", "rest=as recorded")
    assert parse_options(options) == read_file(str(file))


@pytest.mark.parametrize("text", ["a", "=P7", "a=P7,,P8"])
def test_what_is_no_word_of_a_station(text: str) -> None:
    with pytest.raises(BadInput):
        parse_options((text,))


@pytest.mark.parametrize("text", ["- a\n", "a: [P7, as recorded]\n"])
def test_what_is_no_file_of_a_round(text: str, tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(text)
    with pytest.raises(BadInput):
        read_file(str(tmp_path / "bench.yaml"))
    with pytest.raises(BadInput, match="no file"):
        read_file(str(tmp_path / "nothing.yaml"))


class Lab:
    """Keeps what was said."""

    def __init__(self) -> None:
        self.heard: tuple[str, dict[str, list[str]], list[str]] = ("", {}, [])

    def say(
        self, by: str, stations: dict[str, list[str]], as_recorded: list[str], *, finish: bool
    ) -> dict[str, Any]:
        self.heard = (by, stations, as_recorded)
        return {"said": [], "refused": [], "left": []}


def station(name: str, *recorded: str, said: bool = False, must: bool = True, **more: Any) -> dict[str, Any]:
    told = {"workcell": "cell", "kind": "nest", "known": True, "types": {}, "recorded": list(recorded)}
    return {**told, "station": name, "said": said, "must_be_said": must, **more}


def test_what_cannot_be_confirmed_in_passing_is_said_in_full() -> None:
    view = {
        "stations": [
            station("a", "P1"),
            station("b", "P2", must=False),
            station("c", must=False),
            station("d", must=False, said=True),
            station("e"),
        ]
    }
    lab = Lab()
    say(lab, view, {"a": None, "b": None, "e": ["P1"], "rest": None}, "ada")  # type: ignore[arg-type]
    assert lab.heard == ("ada", {"cell/a": ["P1"], "cell/e": ["P1"]}, ["cell/b", "cell/c"])
    with pytest.raises(BadInput, match="no station 'x'"):
        say(lab, view, {"x": []}, "ada")  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="rest"):
        say(lab, view, {"rest": []}, "ada")  # type: ignore[arg-type]


def test_what_the_log_believes_in_words() -> None:
    assert describe_recorded(station("a", "P1+P2", types={"P1": "plate96"})) == "P1+P2 (plate96)"
    assert describe_recorded(station("a")) == "empty"
    assert describe_recorded(station("a", known=False)) == "nothing: it was never declared"
    assert describe_recorded(station("a", "plate96", "plate96", kind="stack")) == "2xplate96"
    assert describe_recorded(station("a", "labware", "labware", kind="waste")) == "2 thrown away"
