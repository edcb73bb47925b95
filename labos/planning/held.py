"""The keys of what runs hold on a floor: doors, modules, setpoints, and what belongs to actions of several
runs together."""

from __future__ import annotations

from functools import cache

from labos.core.ids import ModuleName, split_key

DOOR, HOLD, JOINT, READY = "door", "hold", "joint", "ready"
"""The kinds of keys; the kind stands before the colon."""


@cache
def door_key(module: ModuleName) -> str:
    """The key that a run holds after it has left a door or lid of a module away from rest."""
    return f"{DOOR}:{module}"


@cache
def hold_key(module: ModuleName) -> str:
    """The key that a run holds while its plan reserves a module for it (``holds``)."""
    return f"{HOLD}:{module}"


@cache
def list_guard_keys(module: ModuleName) -> tuple[str, str]:
    """The keys with which a run keeps others from reaching into a module: for its open door, and for a
    reservation."""
    return door_key(module), hold_key(module)


@cache
def joint_claim(module: ModuleName) -> str:
    """The claim of the stations of a module that carries out actions of several runs together."""
    return f"{JOINT}:{module}"


@cache
def ready_key(module: ModuleName) -> str:
    """The key of a run that is ready for an action that a module carries out for several runs together."""
    return f"{READY}:{joint_claim(module)}"


@cache
def done_key(module: ModuleName) -> str:
    """The key of a run whose action a module has carried out already, together with that of another run."""
    return f"{READY}:had:{joint_claim(module)}"


def variable_key(module: ModuleName, variable: str) -> str:
    """The key of a variable of a module that keeps the value of the last action."""
    return f"variable:{module}.{variable}"


def setpoint_key(module: ModuleName, setpoint: str) -> str:
    return f"setpoint:{module}.{setpoint}"


@cache
def find_kept_module(key: str) -> ModuleName:
    """The module that is reserved for a run that holds this key; empty if the key is of another kind."""
    kind, name = split_key(key)
    return ModuleName(name if kind == HOLD else "")


@cache
def may_be_shared(key: str) -> bool:
    """Whether several runs may hold this key, or stand where it is claimed, also for different things. This
    is so for all keys of actions of several runs together."""
    return split_key(key)[0] in (JOINT, READY)
