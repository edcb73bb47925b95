"""The message bus between kernel, nodes and applications."""

from labos.bus._access import MEMBERS, make_access_control
from labos.bus._onlooker import Onlooker, Unheard
from labos.bus._security import SCHEME, Security
from labos.bus._zenoh import ZenohBus, open_bus

__all__ = [
    "MEMBERS",
    "SCHEME",
    "Onlooker",
    "Security",
    "Unheard",
    "ZenohBus",
    "make_access_control",
    "open_bus",
]
