"""SiLA's feature definitions and the messages that follow from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from labos.adapter.sila.describe import actions_of, find_command, find_property, our_name
from labos.adapter.sila.features import Basic, Element, Feature, ListOf, SilaCommand, Structure, read_feature
from labos.adapter.sila.messages import LARGEST_INLINE, Messages
from labos.errors import DeviceError

pytest.importorskip("google.protobuf", reason="needs labos-sdl[sila]")

TEXT = (Path(__file__).parents[2] / "foreign" / "shaker.sila.xml").read_text()
SHAKER = read_feature(TEXT)


def test_arguments_have_types_units_bounds_and_choices() -> None:
    shake, *others = actions_of([SHAKER])
    assert (shake.name, shake.description, shake.result) == ("shake_plate", "Shake the plate.", "any")
    assert shake.aliases == ("ShakingController.ShakePlate",)
    speed, duration, label, mode = shake.args
    assert (speed.name, speed.aliases) == ("speed", ("Speed",))
    assert (speed.type, speed.unit, speed.minimum, speed.maximum) == ("int", "rpm", 1, 2000)
    assert (duration.type, duration.unit, duration.maximum) == ("float", "s", 3600)
    assert (label.type, label.maximum) == ("str", None)
    assert mode.choices == ("Gentle", "Rough")
    program = next(action for action in others if action.name == "run_program")
    assert [arg.type for arg in program.args] == ["file", "list", "str"]
    assert SHAKER.commands[0].errors == ("PlateStuck", "LidOpen")
    assert SHAKER.package == "sila2.example.lab.benches.shakingcontroller.v1"


def test_a_command_is_found_by_any_name_that_means_one_only() -> None:
    commands = (
        SilaCommand("sila2.a.b.door.v1", "Door", "Reset"),
        SilaCommand("sila2.a.b.door.v1", "Door", "OpenDoor"),
    )
    other = Feature("Door", "a", "b", 1, commands)
    features = [SHAKER, other]
    for name in (
        "ShakingController.ShakePlate",
        "ShakePlate",
        "shake_plate",
        "shaking_controller_shake_plate",
    ):
        assert find_command(features, name) is SHAKER.commands[0]
    assert find_command(features, "reset") is None
    assert find_command(features, "Door.Reset") is other.commands[0]
    namesake = Feature("Door", "c", "b", 1, (SilaCommand("sila2.c.b.door.v1", "Door", "Reset"),))
    assert find_command([*features, namesake], "Door.Reset") is None
    assert find_command([*features, namesake], "c/b/Door/v1/Command/Reset") is namesake.commands[0]
    names = [action.name for action in actions_of(features)]
    assert {"shaking_controller_reset", "door_reset", "open_door"} <= set(names)
    assert find_property(features, "ShakingController.Nest.Position.X") == (
        SHAKER.properties[3],
        ["Position", "X"],
    )
    assert find_property(features, "Nest") is None
    assert our_name("GetOD600Value") == "get_od600_value"


@pytest.mark.parametrize(
    ("written", "instead", "said"),
    [
        ("</Feature>", "", "no element found"),
        ("<Basic>Real</Basic>", "<Complex/>", "there is no data type 'Complex'"),
        ("<Observable>Yes</Observable>", "", "has 0 Observable"),
        ("<MinimalInclusive>1<", "<MinimalInclusive>one<", "could not convert"),
        (' Originator="example.lab"', "", "Originator"),
    ],
)
def test_what_cannot_be_read_says_why(written: str, instead: str, said: str) -> None:
    with pytest.raises(DeviceError, match=said) as raised:
        read_feature(TEXT.replace(written, instead))
    assert raised.value.effects == "none"


def echo(kind: Any) -> tuple[Messages, Feature, tuple[Element, ...]]:
    elements = (Element("It", kind),)
    command = SilaCommand("sila2.a.b.echo.v1", "Echo", "Say", parameters=elements)
    feature = Feature("Echo", "a", "b", 1, (command,))
    return Messages([feature]), feature, elements


@pytest.mark.parametrize(
    ("kind", "value", "back"),
    [
        (Basic("String"), "ä", "ä"),
        (Basic("Integer"), -(2**63), -(2**63)),
        (Basic("Real"), 1, 1.0),
        (Basic("Boolean"), True, True),
        (Basic("Binary"), b"\0\xff", b"\0\xff"),
        (Basic("Date"), "2026-02-03", "2026-02-03"),
        (Basic("Time"), "04:05:06.7", "04:05:06.700+00:00"),
        (Basic("Timestamp"), "2026-02-03T04:05:06-03:30", "2026-02-03T04:05:06.000-03:30"),
        (
            ListOf(Structure((Element("X", Basic("Real")),))),
            [{"X": 1.0}, {"X": 2.0}],
            [{"X": 1.0}, {"X": 2.0}],
        ),
        (ListOf(Basic("String")), [], []),
    ],
)
def test_values_come_back_as_they_went(kind: Any, value: Any, back: Any) -> None:
    messages, feature, elements = echo(kind)
    sent = messages.encode(feature.package, "Say_Parameters", elements, {"It": value})
    assert messages.decode(feature.package, "Say_Parameters", elements, sent) == {"It": back}


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (Basic("Integer"), 1.5),
        (Basic("Integer"), True),
        (Basic("Integer"), 2**63),
        (Basic("Real"), "fast"),
        (Basic("Boolean"), 1),
        (Basic("String"), 7),
        (Basic("Date"), "tomorrow"),
        (Basic("Any"), 1),
        (Basic("Binary"), b"x" * (LARGEST_INLINE + 1)),
        (ListOf(Basic("String")), "abc"),
        (ListOf(ListOf(Basic("String"))), [["a"]]),
        (Structure((Element("X", Basic("Real")),)), {"Y": 1.0}),
    ],
)
def test_a_value_that_does_not_fit_is_not_sent(kind: Any, value: Any) -> None:
    messages, feature, elements = echo(kind)
    with pytest.raises(DeviceError, match="It cannot be") as raised:
        messages.encode(feature.package, "Say_Parameters", elements, {"It": value})
    assert raised.value.effects == "none"


def test_bytes_that_are_no_message_are_no_value() -> None:
    messages, feature, elements = echo(Basic("String"))
    with pytest.raises(ValueError, match="not a Say_Parameters"):
        messages.decode(feature.package, "Say_Parameters", elements, b"\x0a\xff")
