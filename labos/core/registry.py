"""The event types by name: the one table between stored bytes and Python values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any, ClassVar, TypeVar, get_args, get_type_hints

import msgspec

from labos.core import upcast
from labos.core.canonical import encode_canonical
from labos.core.envelope import MAX_PAYLOAD_BYTES
from labos.errors import LogTooNew


class Event(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Something that happened. Subclasses are named in the past tense. A field with a default may be added:
    an older LabOS refuses events with unknown fields, also in nested structs. Any other change of form or
    meaning needs a new ``SCHEMA`` and an upcast."""

    TYPE: ClassVar[str] = ""
    SCHEMA: ClassVar[int] = 1
    STREAM: ClassVar[str] = ""
    """The field with the name of the event's stream; empty for the stream of the lab."""

    def stream(self) -> str:
        """The stream of the event: its run, otherwise its subject."""
        return getattr(self, self.STREAM) if self.STREAM else "lab"


E = TypeVar("E", bound=type[Event])

TYPES: dict[str, type[Event]] = {}
_decoders: dict[tuple[str, int], Callable[[bytes], Event]] = {}
"""The decoders for the present version of each type, by type and schema."""


def event(name: str, *, schema: int = 1) -> Callable[[E], E]:
    """Register an event class under its stored name."""

    def register(cls: E) -> E:
        if name in TYPES:
            raise ValueError(f"two event classes claim the type {name!r}")
        cls.TYPE, cls.SCHEMA = name, schema
        TYPES[name] = cls
        _decoders[name, schema] = msgspec.json.Decoder(cls).decode
        return cls

    return register


Handlers = dict[Any, Callable[..., None]]


def list_handlers(
    names: Mapping[str, Any],
    first: type | None,
    prefix: str = "fold_",
    after: tuple[str, ...] = ("event", "at"),
) -> Handlers:
    """The handlers among the ``names`` of a module or class, by the type of their event: its functions with
    this ``prefix`` whose first parameter is a ``first`` (None: ``self``) and that have exactly these
    parameters ``after`` it. Raises TypeError if an event has two."""
    home = names.get("__name__") or names["__module__"]
    found: Handlers = {}
    for name, function in names.items():
        if not name.startswith(prefix) or not isinstance(function, FunctionType):
            continue
        slice_, *others = function.__code__.co_varnames[: function.__code__.co_argcount]
        if function.__module__ != home or tuple(others) != after:
            continue
        hints = get_type_hints(function)
        for kind in get_args(hints["event"]) or (hints["event"],) if hints.get(slice_) is first else ():
            if kind in found:
                raise TypeError(f"{name} and {found[kind].__name__} are both for {kind.__name__}")
            found[kind] = function
    return found


_ENCODED_KEPT = 16
_encoded: dict[int, tuple[Event, bytes]] = {}
"""The last encoded events, by identity: each is encoded when it is decided, and again when it is written.
Events are not changed in between."""


def encode(value: Event) -> bytes:
    """The event's payload. Raises ValueError above 64 KB (larger data must be a blob), for values that
    ``canonical`` refuses, and for a NUL character in the name of its subject."""
    known = _encoded.get(id(value))
    if known is not None and known[0] is value:
        return known[1]
    payload = _encode(value)
    if len(_encoded) >= _ENCODED_KEPT:
        _encoded.clear()
    _encoded[id(value)] = value, payload
    return payload


def _encode(value: Event) -> bytes:
    payload = encode_canonical(value)
    if "\0" in value.stream():
        raise ValueError(f"an event {value.TYPE} contains a name with a NUL character, which is not allowed")
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(
            f"an event {value.TYPE} of {len(payload)} bytes exceeds {MAX_PAYLOAD_BYTES}; "
            "store large data as a blob and record its digest"
        )
    return payload


def decode(type_: str, schema: int, payload: bytes) -> Event:
    """The event of a stored payload. Raises LogTooNew for anything that this version does not know: a type, a
    version, a field, an effect, a topic. Raises msgspec.MsgspecError for a payload that is not an event."""
    decoder = _decoders.get((type_, schema))
    try:
        if decoder is not None:
            return decoder(payload)
        cls = TYPES.get(type_)
        if cls is None or schema > cls.SCHEMA:
            raise LogTooNew(
                f"The log holds {type_!r} in version {schema}, which this LabOS does not know.",
                remedy="Open it with the newer LabOS that wrote it.",
            )
        raw: dict[str, Any] = msgspec.json.decode(payload)
        return msgspec.convert(upcast.lift(type_, schema, cls.SCHEMA, raw), cls)
    except msgspec.ValidationError as error:
        if not _is_newer(str(error)):
            raise
        raise LogTooNew(
            f"The log holds a {type_!r} with something that this LabOS does not know ({error}).",
            remedy="Open it with the newer LabOS that wrote it.",
        ) from error


def _is_newer(fault: str) -> bool:
    """Whether an error message of msgspec is about an unknown field or kind of effect, as from a newer
    version."""
    return "unknown field" in fault or fault.endswith((".effect`", ".topic`"))
