"""The parts of a module's ``config`` that only a file on the lab's own disk may contain: files, programs and
secrets of the computer on which its node runs.

Otherwise a user who sends a workcell over the network could let the node read any file, run any program, or
send a password to any address.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from labos.spec.interfaces import MAPPING_KEYS

ENDINGS = (
    *("_auth", "_env", "_file", "_path", "_folder", "_python", "_program", "_command"),
    *("_certificate", "_key", "_cert", "password", "token", "secret"),
)
"""The ends of keys that name files, programs or secrets, whatever their values are."""

ELSEWHERE = frozenset(
    {*MAPPING_KEYS, "ros_node", "ros_node_address", "representations", "programs", "pendant"}
)
"""Keys with texts for a device; they name nothing on the node's own computer."""

ADDRESSES = ("rest_node_address", "node_url", "url", "source", "host", "address", "sila_address", "opcua_url")
"""Keys with the address to which a secret is sent."""

_A_FILE = re.compile(
    r"/(?!dev/(?!.*\.\.))|~|\.{1,2}[/\\]|[A-Za-z]:[\\/]|\\\\|.*[/\\]\.\.([/\\]|$)"
    r"|(file|spy|alt|hwgrep|loop):",
    re.IGNORECASE | re.DOTALL,
)


def is_secret(key: str) -> bool:
    """Whether a key names a secret, which is sent to the module's address."""
    return key.endswith(("_auth", "_env", "password", "token", "secret"))


def list_on_site(config: Mapping[str, Any], elsewhere: frozenset[str] = frozenset()) -> list[str]:
    """The keys of a config that name files, programs or secrets of the node's computer, as ``bus.logfile``.
    The texts below keys ``elsewhere`` are sent to a device. A device's path below ``/dev`` is its address."""
    found = (
        path
        for key, value in config.items()
        if key not in ELSEWHERE and key not in elsewhere
        for path in _list_paths(key, key, value)
    )
    return list(dict.fromkeys(found))


def _list_paths(path: str, key: str, value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        for inner, item in value.items():
            yield from _list_paths(f"{path}.{inner}", str(inner), item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _list_paths(path, key, item)
    elif value not in (None, "") and (key.endswith(ENDINGS) or _looks_like_a_file(value)):
        yield path


def _looks_like_a_file(value: Any) -> bool:
    return isinstance(value, str) and _A_FILE.match(value) is not None
