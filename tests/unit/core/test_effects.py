"""Filling in an action's declared effects."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.effects import (
    AnyEffect,
    Consumes,
    Move,
    Needs,
    Requires,
    Sets,
    Take,
    list_places,
    resolve,
    resolve_value,
)
from labos.core.ids import StationName


def station(written: str) -> StationName:
    return StationName(f"cell/{written}")


def test_arguments_are_filled_in_and_places_get_their_full_names() -> None:
    effect = Move(
        StationName("{source}"), StationName("{target}"), source_grip="{grip}", via=StationName("{via}")
    )
    args = {"source": "a", "target": "b", "grip": "wide", "via": ""}
    assert resolve(effect, args, station) == Move(
        StationName("cell/a"), StationName("cell/b"), source_grip="wide", via=StationName("")
    )


def test_a_whole_place_holder_keeps_its_type_and_a_part_becomes_text() -> None:
    assert resolve(Consumes("tips", "{amount}"), {"amount": 2.5}, station) == Consumes("tips", 2.5)  # type: ignore[arg-type]
    assert resolve(Sets("module", "at_{n}", "{t} C"), {"n": 3, "t": 37}, station) == Sets(
        "module", "at_3", "37 C"
    )
    assert resolve(Sets("module", "x", "{a}{b}"), {"a": 1, "b": 2}, station) == Sets("module", "x", "12")
    assert resolve(Requires("labware", "sealed", True), {}, station) == Requires("labware", "sealed", True)


@pytest.mark.parametrize("written", ["{missing}", "with {missing}"])
def test_an_argument_that_is_not_there_is_a_key_error(written: str) -> None:
    with pytest.raises(KeyError):
        resolve(Sets("module", "x", written), {"other": 1}, station)


def test_places_are_all_the_stations_named() -> None:
    effects: list[AnyEffect] = [
        Move(StationName("a"), StationName("b"), via=StationName("c")),
        Take(StationName("s"), StationName("t")),
        Needs(StationName("n")),
        Needs(),
        Sets("module", "source", "x"),
    ]
    assert list_places(effects) == {"a", "b", "c", "s", "t", "n"}


def test_effects_are_told_apart_by_their_tag_and_refuse_unknown_fields() -> None:
    decode = msgspec.json.Decoder(AnyEffect).decode
    assert decode(b'{"effect":"take","stack":"s","target":"t"}') == Take(StationName("s"), StationName("t"))
    with pytest.raises(msgspec.ValidationError):
        decode(b'{"effect":"take","stack":"s","target":"t","speed":1}')


def test_what_the_device_decides_is_left_until_it_says_so() -> None:
    slot = Sets("labware", "slot", "{result.slot}")
    assert resolve(slot, {}, StationName) == slot
    assert resolve_value("{result.slot}", {"slot": "s7"}) == "s7"
    assert resolve_value("{result}", 4) == 4
    assert resolve_value("{result.slot}", None) is None
    assert resolve_value("plain", {"slot": "s7"}) == "plain"
