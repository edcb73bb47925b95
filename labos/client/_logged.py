"""One call for each event that an application logs, with the names of the paper's table."""

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
    """Events that an experiment logs. The start and end of the experiment and of each run are logged
    automatically, and so are the calls ``compute``, ``decide``, ``run_flow`` and ``transfer``; these methods
    log everything else."""

    @abstractmethod
    def note(self, kind: str, name: str, **facts: Any) -> None:
        """Log a fact of the application."""

    def log_loop_start(self, loop: str, **facts: Any) -> None:
        """A loop begins. Prefer ``loop``, which also logs its end."""
        self.note("loop_started", loop, **facts)

    def log_loop_end(self, loop: str, **facts: Any) -> None:
        """A loop has ended."""
        self.note("loop_ended", loop, **facts)

    def log_check(self, condition: str, result: bool, *, loop: str = "", **facts: Any) -> bool:
        """A condition was checked, for example the condition of a loop; returns the result."""
        of = {"loop": loop} if loop else {}
        self.note("condition_checked", condition, result=bool(result), **of, **facts)
        return bool(result)

    def log_decision(self, name: str, value: Any, **facts: Any) -> None:
        """A decision was made. Prefer ``decide`` for values that may differ another time."""
        self.note("decision", name, value=value, **facts)

    def log_local_compute(self, function: str, **facts: Any) -> None:
        """This program has computed something. Prefer ``compute``, which logs it automatically."""
        self.note("local_compute", function, **facts)

    def log_remote_compute(self, function: str, **facts: Any) -> None:
        """Something was computed elsewhere, for example by Globus Compute. Prefer ``compute`` where it is
        possible."""
        self.note("compute", function, **facts)

    def log_flow(self, flow: str, *, flow_id: str = "", **facts: Any) -> None:
        """A flow of another service was started, for example of Globus Flows. Prefer ``run_flow`` for own
        flows."""
        self.note("flow", flow, **({"flow_id": flow_id} if flow_id else {}), **facts)

    def log_publication(self, what: str, **facts: Any) -> None:
        """Something was published."""
        self.note("publication", what, **facts)

    @contextmanager
    def loop(self, name: str, **facts: Any) -> Iterator[Loop]:
        """A loop, as a block: its start and its end are logged, also if it ends with an error."""
        self.log_loop_start(name, **facts)
        loop = Loop(self, name)
        try:
            yield loop
        except (ReplayMismatch, LabUnreachable):
            raise  # the program will be started again, and repeats its loop
        except Exception as error:
            loop.report(error=f"{type(error).__name__}: {error}"[:LONGEST_ERROR])
            with suppress(LabosError):  # the first error is the one to report
                self.log_loop_end(name, **loop.facts)
            raise
        self.log_loop_end(name, **loop.facts)


class Loop:
    """A loop of an application. ``facts`` will be logged with its end."""

    def __init__(self, experiment: LoggedEvents, name: str) -> None:
        self._experiment = experiment
        self.name: str = name
        self.facts: dict[str, Any] = {}

    def check(self, condition: str, result: bool, **facts: Any) -> bool:
        """Log that a condition of the loop was checked; returns the result: ``if loop.check(…): break``."""
        return self._experiment.log_check(condition, result, loop=self.name, **facts)

    def report(self, **facts: Any) -> None:
        """Add facts that will be logged with the end of the loop."""
        self.facts.update(facts)
