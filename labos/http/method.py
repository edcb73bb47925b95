"""How a method of ``LabClient`` calls an operation: the client is generated from this and from the types of
the operation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec


class Method(msgspec.Struct, frozen=True):
    """``name`` begins with an underscore if a hand-written method passes its options on to the generated one;
    ``by_hand``: there is only the hand-written one.

    ``positional`` are the first parameters, in order, as ``module, by='somebody', until_ns=until``: a value
    in quotation marks is a default, another one the name that the parameter has in the request. If it is
    empty, they are the names in the path, the required fields of the body, and the requesting user. All other
    parameters are keywords.

    ``take`` is the member of the answer that is returned (none: nothing is returned). With ``repeat`` the
    request may be carried out twice; with a ``key`` it is carried out once, however often it is sent.
    ``fixed`` members of the request are always the same, those ``without`` are never sent. ``timeout_s`` goes
    before the client's own.
    """

    name: str
    positional: str = ""
    take: str | None = ""
    repeat: bool = False
    key: Literal["", "new", "given"] = ""
    fixed: Mapping[str, Any] = {}
    without: tuple[str, ...] = ()
    timeout_s: float | None = None
    by_hand: bool = False
