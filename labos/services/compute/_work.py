"""What runs at the worker, and the digests by which a computation is known."""

from __future__ import annotations

import hashlib
import inspect
import pickle
import platform
import socket
from collections.abc import Callable
from os import getpid
from time import perf_counter
from types import CodeType
from typing import Any

import msgspec

from labos.core.canonical import encode_canonical
from labos.errors import BadInput


class Measured(msgspec.Struct, frozen=True):
    """What a function returned, where it ran, and how long."""

    value: Any
    host: str
    pid: int
    seconds: float
    python: str


def measure(function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]) -> Measured:
    """Call a function, and say where that was. It is imported by name at the worker."""
    begun = perf_counter()
    value = function(*args, **named)
    seconds = perf_counter() - begun
    return Measured(value, socket.gethostname(), getpid(), seconds, platform.python_version())


class Returned(msgspec.Struct, frozen=True):
    """What came of a function: what it returned, or the name and text of its error."""

    measured: Any = None
    error: str = ""
    text: str = ""

    def value(self) -> Any:
        """What it returned. Raises an error of the same name and text as the function has raised."""
        if self.error:
            raise type(self.error, (Exception,), {})(self.text)
        return self.measured


def return_marked(
    mark: str, function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]
) -> tuple[str, Returned]:
    """Call a function at a worker that does not know who asks; returns the mark by which it was asked."""
    try:
        return mark, Returned(function(*args, **named))
    except Exception as error:
        return mark, Returned(error=type(error).__name__, text=str(error))


def do_nothing() -> None:
    """What a group of tasks may begin with."""


def make_name(function: Callable[..., Any]) -> str:
    """Module and name of a function."""
    module = getattr(function, "__module__", "") or ""
    return f"{module}.{getattr(function, '__qualname__', type(function).__qualname__)}".lstrip(".")


def digest_code(function: Callable[..., Any]) -> str:
    """SHA-256 of the file in which a function is written, as others of that file may be called by it; of its
    bytecode where there is no file, as in a notebook; empty for what is not written in Python."""
    try:
        source = inspect.getsourcefile(inspect.unwrap(function))
        if source is not None:
            with open(source, "rb") as file:
                return hashlib.sha256(file.read()).hexdigest()
    except (OSError, TypeError):
        pass
    code = getattr(function, "__code__", None)
    return hashlib.sha256(_encode_code(code)).hexdigest() if isinstance(code, CodeType) else ""


def _encode_code(code: CodeType) -> bytes:
    """Instructions, names and constants; no addresses, which differ from process to process."""
    parts = [code.co_code, repr(code.co_names).encode(), repr(code.co_varnames).encode()]
    for constant in code.co_consts:
        inner = _encode_code(constant) if isinstance(constant, CodeType) else repr(constant).encode()
        parts.append(inner)
    return b"\0".join(parts)


def digest_value(value: Any) -> str:
    """SHA-256 of a value: of its canonical JSON if it has one, else of its pickle."""
    return hashlib.sha256(encode(value)[1]).hexdigest()


def encode(value: Any) -> tuple[str, bytes]:
    """A value as bytes, and their form: json or pickle. Raises BadInput for what has neither."""
    if _is_json(value):
        try:
            return "json", encode_canonical(value)
        except (TypeError, ValueError, OverflowError, RecursionError):
            pass  # numbers that are not finite, and the like
    try:
        return "pickle", pickle.dumps(value, protocol=5)
    except Exception as error:  # __reduce__ of anybody's class
        raise BadInput(
            f"A value of type {type(value).__name__} cannot be sent to another process: {error}.",
            remedy="Give and return numbers, text, lists, tables or arrays.",
        ) from None


def _is_json(value: Any) -> bool:
    """Whether JSON keeps the value as it is: a tuple, a set or an array would come back as something else."""
    if value is None or isinstance(value, bool | int | float | str):
        return type(value) in (type(None), bool, int, float, str)
    if type(value) is list:
        return all(map(_is_json, value))
    return type(value) is dict and all(type(key) is str and _is_json(item) for key, item in value.items())
