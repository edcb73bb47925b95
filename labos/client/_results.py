"""What a lab says of a run."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.errors import NotFound


class StepResult(msgspec.Struct, frozen=True):
    """A step as the log tells it; times in UTC nanoseconds, 0 if not yet."""

    key: str
    module: str
    action: str
    state: str
    result: Any = None
    error: str = ""
    requested_at: int = 0
    ended_at: int = 0


class RunResult(msgspec.Struct, frozen=True):
    """A run as the log tells it. ``status``: queued, active, paused, cancelling, leaving,
    completed, failed or cancelled."""

    id: str
    workflow: str
    user: str
    status: str
    why: str = ""
    experiment: str = ""
    submitted_at: int = 0
    started_at: int = 0
    ended_at: int = 0
    steps: list[StepResult] = []

    @property
    def over(self) -> bool:
        return self.status in ("completed", "failed", "cancelled")

    @property
    def succeeded(self) -> bool:
        return self.status == "completed"

    def result(self, step: str) -> Any:
        """What the step of that name gave back. Raises NotFound."""
        for found in self.steps:
            if found.key == step:
                return found.result
        raise NotFound(f"Run {self.id} has no step {step!r}.")
