"""Converts the return value or exception of a driver's method to the outcome of its action."""

from __future__ import annotations

import asyncio
import functools
import inspect
from collections.abc import Awaitable, Callable
from contextvars import copy_context
from typing import Any

import msgspec
import structlog

from labos.errors import Collision, DeviceError, LabosError, OutcomeUnknown
from labos.node.limits import cut, find_flaw
from labos.node.node import ActionMethod
from labos.node.protocol import EffectsDone, Outcome
from labos.node.world import Crash

RunBlocking = Callable[[Callable[[], Any]], Awaitable[Any]]

_log = structlog.get_logger(__name__)


async def call(method: ActionMethod, kwargs: dict[str, Any], run_blocking: RunBlocking) -> Any:
    """Call a driver's method. A method without ``async`` runs in the driver's thread."""
    if inspect.iscoroutinefunction(method):
        return await method(**kwargs)
    context = copy_context()
    result = await run_blocking(functools.partial(context.run, method, **kwargs))
    return await result if inspect.isawaitable(result) else result


async def find_outcome(
    name: str, calling: Awaitable[Any], *, broken_off: Callable[[], bool], **which: str
) -> Outcome:
    """The outcome of the action ``name``. If ``broken_off`` returns true, a cancellation comes from the node,
    and is raised. Any other cancellation comes from the driver, and the effects on the device are unknown.
    Unexpected errors of the driver are written to the node's log with ``which``. Raises OutcomeUnknown."""
    try:
        result = await calling
    except OutcomeUnknown:
        raise
    except DeviceError as error:
        collided = isinstance(error, Collision)
        return Outcome(False, _parse_effects(error.effects), error=describe_error(error), collided=collided)
    except asyncio.CancelledError:
        if broken_off():
            raise
        return Outcome(False, "unknown", error="The action was cancelled by its driver.")
    except Exception as error:
        _log.exception("action_failed", name=name, **which)
        return Outcome(False, "unknown", error=describe_error(error), collided=isinstance(error, Crash))
    return _make_success(name, result)


def describe_error(error: BaseException) -> str:
    """An error as text for people, within the length limit of the log."""
    try:
        text = str(error)
    except Exception as fault:  # the driver may have its own class of errors
        text = f"(its text cannot be read: {type(fault).__name__})"
    return cut(text if isinstance(error, LabosError) else f"{type(error).__name__}: {text}")


def _make_success(name: str, result: Any) -> Outcome:
    """The outcome of an action without an error. A result that cannot be encoded is a failure."""
    try:
        plain = msgspec.to_builtins(result, str_keys=True)
        flaw = find_flaw(plain)
    except (TypeError, ValueError, RecursionError, msgspec.MsgspecError) as error:
        flaw = describe_error(error) if not isinstance(error, RecursionError) else "it is nested endlessly"
    if flaw:
        return Outcome(
            False, "all", error=f"{name} was done, but its result cannot be recorded: {flaw.rstrip('.')}."
        )
    return Outcome(True, "all", plain)


def _parse_effects(text: str) -> EffectsDone:
    match text:
        case "all" | "none" | "partial":
            return text
    return "unknown"
