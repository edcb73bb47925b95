"""Every wait in one sentence, with names."""

from __future__ import annotations

from labos.core.waits import Wait


def find_remedy(wait: Wait) -> str:
    """What a person can do about a wait; empty if there is nothing to do but wait."""
    return wait.reason.remedy


def describe_wait(wait: Wait) -> str:
    """What a wait is for, in words a scientist uses."""
    return wait.reason.sentence
