"""The base of the calls of a client."""

from __future__ import annotations

import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from contextvars import ContextVar
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from labos.clock import Uuid7Ids
from labos.errors import BadInput

LONG_POLL_S = 20.0

GIVEN_UP: ContextVar[threading.Event | None] = ContextVar("given_up", default=None)
"""Set in the threads of the asynchronous client: after the event is set, no caller waits for the call."""


class CallAbandoned(Exception):
    """No caller waits for this call any more."""


def check_given_up() -> None:
    """Raises GivenUp."""
    given_up = GIVEN_UP.get()
    if given_up is not None and given_up.is_set():
        raise CallAbandoned


def in_path(name: str, parts: int = 1) -> str:
    """A name as one part of a path. Only a name of several ``parts`` may contain slashes: a module is
    ``sealer`` or ``rpl/sealer``. Raises BadInput for a name that would lead to another path."""
    found = name.split("/")
    if len(found) > parts or any(part in ("", ".", "..") for part in found) or _NO_NAME.search(name):
        raise BadInput(f"{name[:80]!r} is not a name in the lab.", remedy="Give one name.")
    return quote(name, safe="")


_NO_NAME = re.compile(r"[\x00-\x1f\x7f\\\ud800-\udfff]")


def fill_path(path: str, values: dict[str, Any]) -> str:
    """A path with the values of the names in braces, which are taken out of ``values``. The name of a module
    may have a slash: ``rpl/sealer``. Raises BadInput."""
    return re.sub(
        r"\{(\w+)\}", lambda found: in_path(values.pop(found[1]), 2 if found[1] == "module" else 1), path
    )


def make_plain(value: Any) -> Any:
    """Convert objects that behave like a list, table or text, and numbers and arrays of numpy. Raises
    BadInput."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Sequence | Set):
        return list(value)
    if isinstance(value, PurePath):
        return str(value)
    if callable(tolist := getattr(value, "tolist", None)):
        return tolist()
    kind = type(value).__name__
    raise BadInput(
        f"Values of the type {kind} cannot be sent to the lab.",
        remedy="Send numbers, texts, and lists and tables of these.",
    )


class Calls(ABC):
    """Base of the groups of calls that make up ``LabClient``."""

    _ids: Uuid7Ids
    approval: str

    @abstractmethod
    def _get(self, path: str, **params: Any) -> dict[str, Any]:
        """Send a GET request. Raises the LabosError that the lab reports, LabUnreachable."""

    @abstractmethod
    def _post(
        self,
        path: str,
        values: Mapping[str, Any],
        *,
        once: bool = False,
        repeat: bool = False,
        as_user: bool = False,
        timeout_s: float | None = None,
    ) -> dict[str, Any]:
        """Send a method's parameters, ``locals()``, as JSON: those in braces in the ``path``, all others in
        the body. With ``once`` the request has a key (the parameter ``request``, or a new one), and is
        carried out once, however often it is sent; ``repeat`` marks a request that may be carried out twice.
        With ``as_user`` the parameter ``user`` is sent as a header. Raises as ``_get``."""

    @abstractmethod
    def _fetch(self, path: str, **params: Any) -> bytes:
        """The content of the answer. Raises as ``_get``."""
