"""How the client calls an operation: its method of ``LabClient`` is written from this and from the types of
the operation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec


class Method(msgspec.Struct, frozen=True):
    """``name`` begins with an underscore where a method with logic of its own stands before it; ``by_hand``:
    there is only that one.

    ``positional`` are the first parameters, in order, as ``module, by='somebody', until_ns=until``: a value
    in quotation marks is a default, another one the name that the parameter has in the request. Left out:
    what stands in the path, what a body must have, and who asks. All others are keywords.

    ``take`` is the member of the answer that is returned (none: nothing is). With ``repeat`` it may be done
    twice; with a ``key`` it is done once, however often it is sent. ``fixed`` members of the request are
    always the same, those ``without`` are never sent. ``timeout_s`` goes before the client's own."""

    name: str
    positional: str = ""
    take: str | None = ""
    repeat: bool = False
    key: Literal["", "new", "given"] = ""
    fixed: Mapping[str, Any] = {}
    without: tuple[str, ...] = ()
    timeout_s: float | None = None
    by_hand: bool = False
