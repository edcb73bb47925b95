"""One call for each event that an application logs: those of the paper's table, by their names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from labos.client._answers import LabUnreachable
from labos.client._replay import ReplayMismatch
from labos.errors import LabosError

LONGEST_ERROR = 500


class LoggedEvents(ABC):
    """What an experiment logs. The start and end of the experiment and of each run are logged by themselves,
    and so is what ``compute``, ``decide``, ``run_flow`` and ``transfer`` do; the rest by these."""

    @abstractmethod
    def note(self, kind: str, name: str, **facts: Any) -> None:
        """Log something of the application's own."""

    def log_loop_start(self, loop: str, **facts: Any) -> None:
        """A loop begins. Prefer ``loop``, which also logs its end."""
        self.note("loop_started", loop, **facts)

    def log_loop_end(self, loop: str, **facts: Any) -> None:
        """A loop has ended."""
        self.note("loop_ended", loop, **facts)

    def log_check(self, condition: str, result: bool, *, loop: str = "", **facts: Any) -> bool:
        """A condition was checked, perhaps that of a loop; returns the result."""
        of = {"loop": loop} if loop else {}
        self.note("condition_checked", condition, result=bool(result), **of, **facts)
        return bool(result)

    def log_decision(self, name: str, value: Any, **facts: Any) -> None:
        """Something was decided. Prefer ``decide`` for what may come out differently another time."""
        self.note("decision", name, value=value, **facts)

    def log_local_compute(self, function: str, **facts: Any) -> None:
        """Something was computed in this program. Prefer ``compute``, which logs it by itself."""
        self.note("local_compute", function, **facts)

    def log_remote_compute(self, function: str, **facts: Any) -> None:
        """Something was computed elsewhere, by Globus Compute, say. Prefer ``compute`` where it can do it."""
        self.note("compute", function, **facts)

    def log_flow(self, flow: str, *, flow_id: str = "", **facts: Any) -> None:
        """A flow of other services was started, by Globus Flows, say. Prefer ``run_flow`` for one's own."""
        self.note("flow", flow, **({"flow_id": flow_id} if flow_id else {}), **facts)

    def log_publication(self, what: str, **facts: Any) -> None:
        """Something was published."""
        self.note("publication", what, **facts)

    @contextmanager
    def loop(self, name: str, **facts: Any) -> Iterator[Loop]:
        """A loop, as a block: its start and its end are logged, also an end by an error."""
        self.log_loop_start(name, **facts)
        loop = Loop(self, name)
        try:
            yield loop
        except (ReplayMismatch, LabUnreachable):
            raise  # the program will be started again, and goes through its loop
        except Exception as error:
            loop.report(error=f"{type(error).__name__}: {error}"[:LONGEST_ERROR])
            with suppress(LabosError):  # the first error is the one to be told
                self.log_loop_end(name, **loop.facts)
            raise
        self.log_loop_end(name, **loop.facts)


class Loop:
    """A loop of an application. ``facts`` are what its end will tell."""

    def __init__(self, experiment: LoggedEvents, name: str) -> None:
        self._experiment = experiment
        self.name: str = name
        self.facts: dict[str, Any] = {}

    def check(self, condition: str, result: bool, **facts: Any) -> bool:
        """Log that a condition of the loop was checked; returns the result: ``if loop.check(…): break``."""
        return self._experiment.log_check(condition, result, loop=self.name, **facts)

    def report(self, **facts: Any) -> None:
        """What the end of the loop will tell."""
        self.facts.update(facts)
