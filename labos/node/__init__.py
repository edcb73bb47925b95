"""The SDK for people who add an instrument."""

from labos.core.counts import Count
from labos.core.effects import (
    Claims,
    Consumes,
    Draws,
    Move,
    Needs,
    Reads,
    Releases,
    Relid,
    Replaces,
    Requires,
    Sets,
    Take,
    Transfers,
    Unlid,
)
from labos.core.model import Station
from labos.errors import Collision, DeviceError, OutcomeUnknown
from labos.node.files import Attachment
from labos.node.motion import assume_motion
from labos.node.node import File, Node, Param, Place, Setup, action, current_action
from labos.node.torture import Case, Fault, Foreign, Hardware, Torture
from labos.node.unit import check_unit
from labos.node.world import Crash, World

__all__ = [
    "Attachment",
    "Case",
    "Claims",
    "Collision",
    "Consumes",
    "Count",
    "Crash",
    "DeviceError",
    "Draws",
    "Fault",
    "File",
    "Foreign",
    "Hardware",
    "Move",
    "Needs",
    "Node",
    "OutcomeUnknown",
    "Param",
    "Place",
    "Reads",
    "Releases",
    "Relid",
    "Replaces",
    "Requires",
    "Sets",
    "Setup",
    "Station",
    "Take",
    "Torture",
    "Transfers",
    "Unlid",
    "World",
    "action",
    "assume_motion",
    "check_unit",
    "current_action",
]
