"""Translates YAML protocols of public workcells into Python protocols that an OT-2 runs.

The format is that of AD-SDL/ot2_module, src/ot2_interface/protopiler/config.py. Of its commands,
``transfer``, ``mix``, ``replace_tip`` and ``change_temp`` are translated. Any other entry is refused.
"""

from __future__ import annotations

import pprint
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from labos.errors import DeviceError

INTERPRETER = Path(__file__).with_name("interpreter.py")
TRANSFER = {
    *("source", "destination", "volume", "aspirate_clearance", "dispense_clearance"),
    *("mix_cycles", "mix_volume", "blow_out", "drop_tip"),
}
COMMANDS: dict[str, tuple[set[str], set[str]]] = {
    "transfer": ({"source", "destination", "volume"}, TRANSFER),
    "mix": ({"reps", "mix_volume", "location"}, {"reps", "mix_volume", "location"}),
    "replace_tip": ({"replace_tip"}, {"replace_tip"}),
    "change_temp": ({"change_temp"}, {"change_temp"}),
}
"""What each has to say, and what it may."""
MAY_BE_LISTS = {"source", "destination", "volume", "location"}
LABWARE, PIPETTE = {"name", "location", "alias", "module", "offset"}, {"name", "mount"}


def translate(name: str, content: bytes) -> bytes:
    """The protocol in Python. Raises DeviceError if a part of it cannot be translated."""
    metadata = {key: str(value) for key, value in (_read(name, content).get("metadata") or {}).items()}
    plan = make_plan(name, content)
    return b"".join(
        (
            INTERPRETER.read_bytes(),
            f"\n\nmetadata = {pprint.pformat({'apiLevel': '2.12', **metadata})}\n".encode(),
            f"PLAN = {pprint.pformat(plan, width=100, sort_dicts=False)}\n".encode(),
        )
    )


def make_plan(name: str, content: bytes) -> dict[str, Any]:
    """The plan for the interpreter. Raises DeviceError if a part of it cannot be translated."""
    written = _read(name, content)
    equipment = _read_entries(name, written, "equipment")
    for item in equipment:
        _check_keys(name, item, PIPETTE if "mount" in item else LABWARE, "equipment")
    return {
        "labware": [item for item in equipment if "mount" not in item],
        "pipettes": [item for item in equipment if "mount" in item],
        "commands": [
            _read_command(name, number, item)
            for number, item in enumerate(_read_entries(name, written, "commands"), 1)
        ],
    }


def _read(name: str, content: bytes) -> dict[str, Any]:
    try:
        written = yaml.safe_load(content)
    except yaml.YAMLError as error:
        raise _make_error(name, f"it is not YAML: {error}") from error
    if not isinstance(written, dict):
        raise _make_error(name, "it is not a protocol")
    return written


def _read_command(name: str, number: int, item: dict[str, Any]) -> dict[str, Any]:
    """A command with a name. Raises DeviceError if a key is missing or would be ignored."""
    settings = {key: value for key, value in item.items() if key not in ("name", "command")}
    kind = str(item.get("command") or next((k for k in COMMANDS if k in settings), "transfer"))
    if kind not in COMMANDS:
        raise _make_error(name, f"command {number}: {kind!r} is not known")
    needed, allowed = COMMANDS[kind]
    if missing := sorted(needed - settings.keys()):
        raise _make_error(name, f"command {number} ({kind}) has no {', '.join(missing)}")
    _check_keys(name, settings, allowed, f"command {number} ({kind})")
    lists = sorted(key for key in settings.keys() - MAY_BE_LISTS if isinstance(settings[key], list))
    if lists:
        raise _make_error(name, f"command {number} ({kind}): a list for {', '.join(lists)} is not translated")
    return {"name": str(item.get("name") or kind), **settings}


def _read_entries(name: str, written: dict[str, Any], key: str) -> list[dict[str, Any]]:
    found = written.get(key)
    if not isinstance(found, list) or not found or not all(isinstance(item, dict) for item in found):
        raise _make_error(name, f"its {key} are not a list of entries")
    return found


def _check_keys(name: str, item: dict[str, Any], allowed: Iterable[str], where: str) -> None:
    if unknown := sorted(map(str, item.keys() - set(allowed))):
        raise _make_error(name, f"{where}: {', '.join(unknown)} is not translated")


def _make_error(name: str, why: str) -> DeviceError:
    return DeviceError(
        f"The protocol {name} cannot be translated for an OT-2: {why}.",
        effects="none",
        remedy="Correct it, or write it in Python.",
    )
