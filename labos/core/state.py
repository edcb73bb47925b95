"""The whole state of a lab, composed of its slices, and its snapshots."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from importlib import resources as package_files
from importlib.resources.abc import Traversable
from typing import Any

import msgspec

from labos.core.actions import Actions
from labos.core.approvals import Approvals
from labos.core.bench import Bench
from labos.core.bookings import Bookings
from labos.core.campaigns import Campaigns
from labos.core.erasure import Erasures
from labos.core.interventions import Interventions
from labos.core.lab import Lab
from labos.core.lengths import Lengths
from labos.core.modules import Modules
from labos.core.open_experiments import Experiments
from labos.core.plans import share_plans
from labos.core.resources import Resources
from labos.core.runs import Runs
from labos.core.shares import Shares
from labos.core.shorter import Shorter
from labos.core.suggestions import Suggestions
from labos.core.users import Users


class LabState(msgspec.Struct):
    """The state after the events up to ``position``. ``versions`` counts the events of each stream that is
    alive."""

    position: int = 0
    recorded_at: int = 0
    lab: Lab = msgspec.field(default_factory=Lab)
    modules: Modules = msgspec.field(default_factory=Modules)
    bench: Bench = msgspec.field(default_factory=Bench)
    actions: Actions = msgspec.field(default_factory=Actions)
    runs: Runs = msgspec.field(default_factory=Runs)
    resources: Resources = msgspec.field(default_factory=Resources)
    interventions: Interventions = msgspec.field(default_factory=Interventions)
    experiments: Experiments = msgspec.field(default_factory=Experiments)
    shares: Shares = msgspec.field(default_factory=Shares)
    campaigns: Campaigns = msgspec.field(default_factory=Campaigns)
    versions: dict[str, int] = {}
    shorter: Shorter = msgspec.field(default_factory=Shorter)
    users: Users = msgspec.field(default_factory=Users)
    approvals: Approvals = msgspec.field(default_factory=Approvals)
    bookings: Bookings = msgspec.field(default_factory=Bookings)
    suggestions: Suggestions = msgspec.field(default_factory=Suggestions)
    erasures: Erasures = msgspec.field(default_factory=Erasures)
    lengths: Lengths = msgspec.field(default_factory=Lengths)


# Tables keep their order: the order of arrival is part of the state.
_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(LabState)
# Old logs, from before numbers were limited to 64 bits, may contain longer ones, which MessagePack cannot
# express.
_wide_encoder = msgspec.json.Encoder()
_wide_decoder = msgspec.json.Decoder(LabState)
_WIDE = b"{"
"""The first byte of a snapshot in JSON. A snapshot in MessagePack begins with the mark of a map, which is
above 0x7f."""


def encode_picture(state: LabState) -> bytes:
    """The state as bytes. The same events always give the same bytes."""
    try:
        return _encoder.encode(state)
    except OverflowError:
        return _wide_encoder.encode(state)


def from_picture(data: bytes) -> LabState:
    """The state from a snapshot. Raises msgspec.MsgspecError if the bytes do not fit this form of the
    state."""
    decoder = _wide_decoder if data[:1] == _WIDE else _decoder
    state: LabState = decoder.decode(data)
    share_plans(state.runs.plans)
    return state


def rewrite_picture(data: bytes, change: Callable[[str], str]) -> bytes:
    """A snapshot with each of its texts changed. It no longer corresponds to events, and is only for
    showing."""
    codec: Any = msgspec.json if data[:1] == _WIDE else msgspec.msgpack

    def change_value(value: Any) -> Any:
        if isinstance(value, str):
            return change(value)
        if isinstance(value, list):
            return [change_value(item) for item in value]
        if isinstance(value, dict):
            return {key: change_value(item) for key, item in value.items()}
        return value

    return bytes(codec.encode(change_value(codec.decode(data))))


def hash_state(state: LabState) -> str:
    return hashlib.sha256(encode_picture(state)).hexdigest()


@cache
def fold_fingerprint() -> str:
    """The fingerprint of the fold code. A snapshot from other code is not used. It is computed once: a
    process runs the code with which it started, also when an upgrade replaces the files."""
    return fingerprint_folder(package_files.files("labos.core"))


def fingerprint_folder(folder: Traversable) -> str:
    """The SHA-256 of the Python files of a folder."""
    total = hashlib.sha256()
    for file in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".py"):
            total.update(file.name.encode())
            total.update(file.read_bytes())
    return total.hexdigest()
