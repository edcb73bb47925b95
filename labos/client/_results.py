"""A lab's reports on a run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import msgspec

from labos.errors import BadInput, NotFound

if TYPE_CHECKING:
    import pandas

    from labos.client._lab import LabClient
    from labos.services.results import Readings


class StepResult(msgspec.Struct, frozen=True):
    """A step from the log; times in UTC nanoseconds, 0 if not yet."""

    key: str
    module: str
    action: str
    state: str
    result: Any = None
    error: str = ""
    requested_at: int = 0
    ended_at: int = 0


class RunResult(msgspec.Struct, frozen=True, dict=True):
    """A run from the log. ``status``: queued, active, paused, cancelling, leaving, completed, failed or
    cancelled. ``due_at`` is its due date."""

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
    due_at: int = 0

    @property
    def over(self) -> bool:
        return self.status in ("completed", "failed", "cancelled")

    @property
    def succeeded(self) -> bool:
        return self.status == "completed"

    def result(self, step: str) -> Any:
        """The result of the step with that name. Raises NotFound."""
        for found in self.steps:
            if found.key == step:
                return found.result
        raise NotFound(f"Run {self.id} has no step {step!r}.")

    def files(self) -> list[dict[str, Any]]:
        """The files that steps returned, each with ``step``, ``file`` (its name), ``sha256`` and further
        fields: ``LabClient.file``, ``image`` and ``table`` read them."""
        return [{"step": step.key, **file} for step in self.steps for file in _iterate_files(step.result)]

    def readings(self) -> Readings:
        """The values that it measured, well by well, each with the sample that was in its well."""
        lab: LabClient | None = vars(self).get("_lab")
        if lab is None:
            raise BadInput("This run did not come from a lab.", remedy="Use LabClient.readings(run).")
        return lab.readings(self.id)

    def to_frame(self) -> pandas.DataFrame:
        """The readings as a pandas table (extra ``analysis``)."""
        return self.readings().to_frame()

    def to_csv(self, file: str | Path | TextIO | None = None) -> str:
        """The readings as CSV, as `labos results --csv` writes it."""
        return self.readings().to_csv(file)


def _iterate_files(result: Any) -> Iterator[dict[str, Any]]:
    """The entries that name a file in a result, at any depth."""
    if isinstance(result, dict):
        if isinstance(result.get("sha256"), str):
            yield result
        else:
            for value in result.values():
                yield from _iterate_files(value)
    elif isinstance(result, list):
        for value in result:
            yield from _iterate_files(value)
