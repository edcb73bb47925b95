"""What the calls of a client are made with."""

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
"""Set in the threads of the asynchronous client: once the event is set, nobody waits for the call."""


class CallAbandoned(Exception):
    """Nobody waits for this call any more."""


def check_given_up() -> None:
    """Raises GivenUp."""
    given_up = GIVEN_UP.get()
    if given_up is not None and given_up.is_set():
        raise CallAbandoned


def in_path(name: str, parts: int = 1) -> str:
    """A name as it stands in a path, as one part of it. Only a name of several ``parts`` may have slashes:
    that of a module is ``sealer`` or ``rpl/sealer``. Raises BadInput for what would lead elsewhere."""
    found = name.split("/")
    if len(found) > parts or any(part in ("", ".", "..") for part in found) or _NO_NAME.search(name):
        raise BadInput(f"{name[:80]!r} names nothing in the lab.", remedy="Say which one is meant.")
    return quote(name, safe="")


_NO_NAME = re.compile(r"[\x00-\x1f\x7f\\\ud800-\udfff]")


def make_plain(value: Any) -> Any:
    """What is no list, table or text itself, but used as one; numbers and arrays of numpy. Raises
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
    raise BadInput(f"The lab takes no {kind}.", remedy="Send numbers, texts, lists and tables of them.")


class Calls(ABC):
    """Base of the groups of calls that make up ``LabClient``."""

    _ids: Uuid7Ids
    approval: str

    @abstractmethod
    def _get(self, path: str, **params: Any) -> dict[str, Any]:
        """Ask. Raises LabosError as the lab did, LabUnreachable."""

    @abstractmethod
    def _post(
        self,
        path: str,
        body: Any,
        *,
        request: str = "",
        user: str = "",
        repeat: bool = False,
        timeout_s: float | None = None,
    ) -> dict[str, Any]:
        """Send ``body`` as JSON. With a ``request`` key it is done once, however often it is sent; ``repeat``
        is for what may be done twice. Raises as ``_get``."""

    @abstractmethod
    def _fetch(self, path: str, **params: Any) -> bytes:
        """The answer as it is. Raises as ``_get``."""
