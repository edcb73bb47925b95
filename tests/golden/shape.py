"""A state reduced to what an earlier version knew of it.

A later version may give a struct of the state a new field; that is no difference. A table with
another entry, a field that is gone, or any other value is one.
"""

from __future__ import annotations

import hashlib
from typing import Any

import msgspec

from labos.core.canonical import canonical


def known_then(now: Any, then: Any) -> Any:
    """``now`` as JSON values, without the fields of structs that ``then`` does not have."""
    if isinstance(now, msgspec.Struct):
        known = then if isinstance(then, dict) else {}
        tag = now.__struct_config__.tag_field
        plain = {name: getattr(now, name) for name in now.__struct_fields__ if name in known}
        reduced = {name: known_then(value, known[name]) for name, value in plain.items()}
        if tag is not None and tag in known:
            reduced[tag] = now.__struct_config__.tag
        return reduced
    if isinstance(now, dict):
        told = then if isinstance(then, dict) else {}
        return {_key(key): known_then(value, told.get(_key(key))) for key, value in now.items()}
    if isinstance(now, list | tuple):
        told_list = then if isinstance(then, list) and len(then) == len(now) else [None] * len(now)
        return [known_then(value, told) for value, told in zip(now, told_list, strict=True)]
    return msgspec.to_builtins(now, str_keys=True)


def _key(key: Any) -> str:
    built = msgspec.to_builtins({key: None}, str_keys=True)
    return str(next(iter(built)))


def plain_hash(plain: Any) -> str:
    """SHA-256 of JSON values, whatever the order of their keys."""
    return hashlib.sha256(canonical(plain)).hexdigest()
