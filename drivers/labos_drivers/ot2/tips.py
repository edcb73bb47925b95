"""Counts the tips that a protocol uses up, before anything moves.

A YAML protocol is run by the same interpreter that is sent to the robot, on a deck that only counts. Of
Opentrons' JSON protocols, the commands are counted. Python is only read (``ot2/reading.py``), and never run.
Sources: Opentrons/opentrons, shared-data/protocol/schemas 1 to 8 (``procedure`` and ``pick-up-tip``, then
``commands`` with ``pickUpTip``).
"""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from labos.errors import DeviceError
from labos.node import Count
from labos_drivers.ot2.calls import Doubt, count_channels
from labos_drivers.ot2.reading import count_tips
from labos_drivers.ot2.translate import INTERPRETER, make_plan

MOST_STROKES = 100_000
"""A protocol in YAML that does more than this is not counted to its end."""
IN_PYTHON = 'Write it there, beside `metadata`: `resources = {"tips": N}`.'


def count_used_tips(name: str, content: bytes, args: Mapping[str, Any]) -> Count:
    """The number of tips that ``run_protocol`` uses up with these arguments."""
    values = values_of(args)
    match name.lower().rpartition(".")[2]:
        case "yaml" | "yml":
            return _count_in_yaml(name, content, values)
        case "json":
            return _count_in_json(content)
        case "py":
            found = count_tips(content, values)
            return Count(found.amount, found.doubt, IN_PYTHON if found.doubt else "")
    return Count(0.0, "it is not a protocol for an OT-2")


def values_of(args: Mapping[str, Any]) -> dict[str, Any]:
    """The values that a protocol finds under ``payload`` and in ``LABOS``, from the arguments of its action.
    Missing arguments are left out, and so are empty volumes and source wells."""
    values = dict(args.get("variables") or {})
    values |= {name: value for name, value in args.items() if name.endswith("_volumes") and value}
    if "destination_wells" in args:
        values["destination_wells"] = args["destination_wells"] or []
    if args.get("source_wells"):
        values["source_wells"] = args["source_wells"]
    if "use_existing_resources" in args:
        values["use_existing_resources"] = args["use_existing_resources"]
    return values


# -- YAML ------------------------------------------------------------------------------------


def _count_in_yaml(name: str, content: bytes, values: Mapping[str, Any]) -> Count:
    deck = _Deck()
    try:
        interpreter = _load_interpreter()
        interpreter.PLAN, interpreter.LABOS = make_plan(name, content), dict(values)  # type: ignore[attr-defined]
        interpreter.run(deck)
    except DeviceError as error:
        return Count(deck.tips, error.message.rstrip("."))
    except KeyError as error:
        return Count(deck.tips, f"it names {error}, which is not known")
    except Doubt as doubt:
        return Count(deck.tips, str(doubt))
    except (TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        return Count(deck.tips, f"it cannot be followed ({error})")
    return Count(deck.tips)


def _load_interpreter() -> ModuleType:
    """A new copy of the interpreter, because it keeps the plan of one protocol in its globals."""
    spec = importlib.util.spec_from_file_location("labos_drivers.ot2._counting", INTERPRETER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class _Deck:
    """Takes the place of the robot for the interpreter, and counts tips."""

    def __init__(self) -> None:
        self.tips = 0.0
        self._strokes = 0

    def stroke(self) -> None:
        self._strokes += 1
        if self._strokes > MOST_STROKES:
            raise Doubt(f"it has more than {MOST_STROKES} strokes")

    def comment(self, text: str) -> None:
        self.stroke()

    def load_labware(self, name: str, where: str) -> _Rack:
        return _Rack(self, str(name))

    def load_module(self, name: str, where: str) -> _Module:
        return _Module(self)

    def load_instrument(self, name: str, mount: str) -> _Pipette:
        return _Pipette(self, str(name))


class _Module:
    def __init__(self, deck: _Deck) -> None:
        self._deck = deck

    def load_labware(self, name: str) -> _Rack:
        return _Rack(self._deck, str(name))

    def set_temperature(self, celsius: Any) -> None:
        """Does nothing: it needs no tip."""


class _Rack:
    """Labware, of which only the name is known."""

    def __init__(self, deck: _Deck, name: str) -> None:
        self._deck = deck
        self.is_tiprack = "tiprack" in name
        self.max_volume = _parse_volume_ul(name) if self.is_tiprack else 0.0

    def set_offset(self, **_: float) -> None:
        """Does nothing: it needs no tip."""

    def wells(self) -> list[_Well]:
        return [_Well(self.max_volume)]

    def __getitem__(self, well: str) -> _Well:
        self._deck.stroke()
        if not re.fullmatch(r"[A-P]\d{1,2}", well):
            raise Doubt(f"its well {well!r} is in another file")
        return _Well(self.max_volume)


class _Well:
    def __init__(self, max_volume: float) -> None:
        self.max_volume = max_volume

    def bottom(self, clearance: float) -> None:
        """A position in the well, which does not matter for the count."""

    def top(self) -> None:
        """A position in the well, which does not matter for the count."""


class _Pipette:
    def __init__(self, deck: _Deck, name: str) -> None:
        self._deck = deck
        self.max_volume = _parse_volume_ul(name)
        self.min_volume = 0.0  # the number of tips does not depend on it
        self.has_tip = False
        self._channels = count_channels(name)

    def pick_up_tip(self) -> None:
        self.has_tip = True
        self._deck.tips += self._channels

    def drop_tip(self) -> None:
        self.has_tip = False

    def aspirate(self, *_: Any) -> None:
        self._deck.stroke()

    dispense = mix = blow_out = aspirate


def _parse_volume_ul(name: str) -> float:
    """The volume in a name (µL): 300 for ``p300_multi_gen2`` and ``opentrons_96_tiprack_300ul``."""
    found = re.match(r"p(\d+)", name) or re.search(r"(\d+)ul", name)
    if found is None:
        raise Doubt(f"{name!r} has no known volume")
    return float(found[1])


# -- JSON ------------------------------------------------------------------------------------


def _count_in_json(content: bytes) -> Count:
    try:
        protocol = json.loads(content)
        tips, names = 0.0, _list_pipettes(protocol)
        for kind, params in _list_commands(protocol):
            if kind == "configureNozzleLayout":
                return Count(tips, "it changes how many tips are picked up at once")
            if kind in ("pickUpTip", "pick-up-tip"):
                used = params.get("pipetteId", params.get("pipette"))
                if used not in names:
                    return Count(tips, f"it picks up tips with {used!r}, which it does not load")
                tips += count_channels(names[used])
    except (ValueError, AttributeError, TypeError, KeyError) as error:
        return Count(0.0, f"it is not a protocol in JSON ({error})")
    except Doubt as doubt:
        return Count(tips, str(doubt))
    return Count(tips)


def _list_pipettes(protocol: Any) -> dict[str, str]:
    """The maker's name of each pipette, by the name that the commands use."""
    loaded = protocol.get("pipettes") or {}
    names = {key: str(p.get("name") or p.get("model") or p.get("pipetteName")) for key, p in loaded.items()}
    for kind, params in _list_commands(protocol):
        if kind == "loadPipette" and params.get("pipetteName"):
            names[params["pipetteId"]] = params["pipetteName"]
    return names


def _list_commands(protocol: Any) -> list[tuple[str, dict[str, Any]]]:
    """All commands with their parameters, for every version of the schema. Raises ValueError."""
    if "commands" not in protocol and "procedure" not in protocol:
        raise ValueError("it has no commands")
    steps = protocol.get("commands") or [s for part in protocol["procedure"] for s in part["subprocedure"]]
    return [(step.get("commandType") or step["command"], step.get("params") or {}) for step in steps]
