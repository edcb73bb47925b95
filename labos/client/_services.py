"""Computations of an experiment, each with an event that says what was computed, where, and from what."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from concurrent.futures import Future

    from labos.services.compute import Attempts, Computed, ComputeFailed, Computing

LARGEST_IN_EVENT = 16 * 1024
"""Bytes of a result that stand in its event; more of them are a file of the lab."""

LONGEST_ERROR = 1000


class ExperimentLog(Protocol):
    """What computations need of an experiment."""

    def note(self, kind: str, name: str, **facts: Any) -> None: ...

    def keep_file(self, content: bytes) -> str: ...


class Computations:
    """Of one experiment. Nothing is opened or imported before the first of them."""

    def __init__(self, experiment: ExperimentLog) -> None:
        self._experiment = experiment
        self._places: dict[str, Any] = {}
        self._attempts: Attempts | None = None
        self._computing: Computing | None = None

    def configure(self, places: Mapping[str, Any], attempts: Attempts | None) -> None:
        from labos.errors import BadInput

        if self._computing is not None:
            raise BadInput("Computations have begun.", remedy="Say where to compute before the first one.")
        self._places, self._attempts = dict(places), attempts

    def submit(
        self, function: Callable[..., Any], args: tuple[Any, ...], named: Mapping[str, Any], where: str
    ) -> Future[Any]:
        from labos.services.compute import Computing

        if self._computing is None:
            self._computing = Computing(self._places, self._attempts)
        kind = "local_compute" if where in ("local", "pool") else "compute"
        return self._computing.submit(
            function,
            args,
            named,
            where=where,
            then=lambda computed: self._tell(kind, computed),
            failed=lambda error: self._tell_failure(kind, error),
        )

    def submit_all(self, function: Callable[..., Any], of: Iterable[Any], where: str) -> list[Future[Any]]:
        return [self.submit(function, (each,), {}, where) for each in of]

    def close(self, *, drop: bool, wait: bool) -> None:
        if self._computing is not None:
            self._computing.close(drop=drop, wait=wait)
            self._computing = None

    def _tell(self, kind: str, computed: Computed) -> Any:
        """The event is in the log before the application has the result."""
        from labos.services.compute._work import encoded

        measured = computed.measured
        form, content = encoded(measured.value)
        facts: dict[str, Any] = {
            "code": computed.code,
            "arguments": computed.arguments,
            "where": computed.where,
            "host": measured.host,
            "process": measured.pid,
            "python": measured.python,
            "seconds": round(measured.seconds, 6),
            "attempts": computed.attempts,
            "result_form": form,
            "result_sha256": hashlib.sha256(content).hexdigest(),
        }
        if form == "json" and len(content) <= LARGEST_IN_EVENT:
            facts["result"] = measured.value
        else:
            facts["result_file"] = self._experiment.keep_file(content)
        self._experiment.note(kind, computed.function, **facts)
        return measured.value

    def _tell_failure(self, kind: str, failed: ComputeFailed) -> None:
        self._experiment.note(
            kind,
            failed.function,
            code=failed.code,
            arguments=failed.arguments,
            where=failed.where,
            attempts=failed.attempts,
            error=f"{type(failed.error).__name__}: {failed.error}"[:LONGEST_ERROR],
        )
