"""The keys of what runs hold on a floor: doors, modules, setpoints, and what several of them do at once."""

from __future__ import annotations

from functools import cache

from labos.core.ids import ModuleName, split_key

DOOR, HOLD, JOINT, READY = "door", "hold", "joint", "ready"
"""Kinds of keys, which stand before the colon."""


@cache
def door_key(module: ModuleName) -> str:
    """What a run holds that left a door or lid of a module away from rest."""
    return f"{DOOR}:{module}"


@cache
def hold_key(module: ModuleName) -> str:
    """What a run holds whose plan reserves a module for it (``holds``)."""
    return f"{HOLD}:{module}"


@cache
def list_guard_keys(module: ModuleName) -> tuple[str, str]:
    """What a run holds that keeps others from reaching into a module: its open door, or a reservation."""
    return door_key(module), hold_key(module)


@cache
def joint_claim(module: ModuleName) -> str:
    """What the stations of a module claim that does things for several runs at once."""
    return f"{JOINT}:{module}"


@cache
def ready_key(module: ModuleName) -> str:
    """What a run holds that is ready for what a module does for several runs at once."""
    return f"{READY}:{joint_claim(module)}"


@cache
def done_key(module: ModuleName) -> str:
    """What a run holds for which a module has done it already, together with another one."""
    return f"{READY}:had:{joint_claim(module)}"


def variable_key(module: ModuleName, variable: str) -> str:
    """A variable of a module that stays as the last action has set it."""
    return f"variable:{module}.{variable}"


def setpoint_key(module: ModuleName, setpoint: str) -> str:
    return f"setpoint:{module}.{setpoint}"


@cache
def find_kept_module(key: str) -> ModuleName:
    """The module that is reserved for a run that holds this; empty if it is something else."""
    kind, name = split_key(key)
    return ModuleName(name if kind == HOLD else "")


@cache
def may_be_shared(key: str) -> bool:
    """Whether several runs may hold this or stand where it is claimed, also for different things: all that
    has to do with what a module does for several of them at once."""
    return split_key(key)[0] in (JOINT, READY)
