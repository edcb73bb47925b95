"""The code that runs at the worker, and the digests that identify a computation."""

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
    """The value that a function returned, where it ran, and how long it took."""

    value: Any
    host: str
    pid: int
    seconds: float
    python: str


def measure(function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]) -> Measured:
    """Call a function, and report where it ran. The worker imports this function by name."""
    begun = perf_counter()
    value = function(*args, **named)
    seconds = perf_counter() - begun
    return Measured(value, socket.gethostname(), getpid(), seconds, platform.python_version())


class Returned(msgspec.Struct, frozen=True):
    """The outcome of a function: its value, or the name and text of its error."""

    measured: Any = None
    error: str = ""
    text: str = ""

    def value(self) -> Any:
        """The value. Raises an error with the name and text of the function's error."""
        if self.error:
            raise type(self.error, (Exception,), {})(self.text)
        return self.measured


def return_marked(
    mark: str, function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]
) -> tuple[str, Returned]:
    """Call a function at a worker that does not know the caller; returns the mark that came with the call,
    and the outcome."""
    try:
        return mark, Returned(function(*args, **named))
    except Exception as error:
        return mark, Returned(error=type(error).__name__, text=str(error))


def do_nothing() -> None:
    """A function for the first task of a group; it does nothing."""


def make_name(function: Callable[..., Any]) -> str:
    """Module and name of a function."""
    module = getattr(function, "__module__", "") or ""
    return f"{module}.{getattr(function, '__qualname__', type(function).__qualname__)}".lstrip(".")


def digest_code(function: Callable[..., Any]) -> str:
    """SHA-256 of the file that contains a function, because the function may call others of that file. If
    there is no file, as in a notebook: of its bytecode. Empty for a function that is not written in
    Python."""
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
    """Instructions, names and constants; no addresses, because these differ between processes."""
    parts = [code.co_code, repr(code.co_names).encode(), repr(code.co_varnames).encode()]
    for constant in code.co_consts:
        inner = _encode_code(constant) if isinstance(constant, CodeType) else repr(constant).encode()
        parts.append(inner)
    return b"\0".join(parts)


def digest_value(value: Any) -> str:
    """SHA-256 of a value: of its canonical JSON if it has one, else of its pickle."""
    return hashlib.sha256(encode(value)[1]).hexdigest()


def encode(value: Any) -> tuple[str, bytes]:
    """A value as bytes, and their form: json or pickle. Raises BadInput for a value that has neither."""
    if _is_json(value):
        try:
            return "json", encode_canonical(value)
        except (TypeError, ValueError, OverflowError, RecursionError):
            pass  # numbers that are not finite, for example
    try:
        return "pickle", pickle.dumps(value, protocol=5)
    except Exception as error:  # __reduce__ of any class
        raise BadInput(
            f"A value of type {type(value).__name__} cannot be sent to another process: {error}.",
            remedy="Give and return numbers, text, lists, tables or arrays.",
        ) from None


def _is_json(value: Any) -> bool:
    """Whether JSON keeps the value unchanged: a tuple, a set or an array would be read back as another
    type."""
    if value is None or isinstance(value, bool | int | float | str):
        return type(value) in (type(None), bool, int, float, str)
    if type(value) is list:
        return all(map(_is_json, value))
    return type(value) is dict and all(type(key) is str and _is_json(item) for key, item in value.items())
