"""Computations of an experiment, each with an event that names the function, the place and the arguments."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from labos.client._record import LARGEST_IN_EVENT, ExperimentRecord, function_name
from labos.client._replay import ReplayMismatch, plain_digest

if TYPE_CHECKING:
    from concurrent.futures import Future

    from labos.services.compute import Attempts, Computed, ComputeFailed, Computing

LONGEST_ERROR = 1000

LONGEST_SHOWN = 200


class Computations:
    """The computations of one experiment. Nothing is opened or imported before the first of them."""

    def __init__(self, record: ExperimentRecord) -> None:
        self._record = record
        self._places: dict[str, Any] = {}
        self._attempts: Attempts | None = None
        self._computing: Computing | None = None

    def configure(self, places: Mapping[str, Any], attempts: Attempts | None) -> None:
        from labos.errors import BadInput

        if self._computing is not None:
            raise BadInput(
                "Computations have already started.",
                remedy="Configure the place before the first computation.",
            )
        self._places, self._attempts = dict(places), attempts

    def submit(
        self,
        function: Callable[..., Any],
        args: tuple[Any, ...],
        named: Mapping[str, Any],
        where: str,
        key: str,
    ) -> Future[Any]:
        from labos.services.compute import Computing

        what = plain_digest({"args": args, "named": named})
        known = self._record.find_note(key)
        if known is not None:
            return self._replay(known, function, args, named, what)
        if self._computing is None:
            self._computing = Computing(self._places, self._attempts)
        kind = "local_compute" if where in ("local", "pool") else "compute"
        return self._computing.submit(
            function,
            args,
            named,
            where=where,
            then=lambda computed: self._log_computation(key, kind, computed, what),
            failed=lambda error: self._log_failure(key, kind, error, what),
            unavailable=lambda: self._record.give_back(key),
            sent=lambda attempt: self._record.find_sent(f"{key} attempt {attempt}", "Globus Compute"),
        )

    def _replay(
        self,
        known: Mapping[str, Any],
        function: Callable[..., Any],
        args: tuple[Any, ...],
        named: Mapping[str, Any],
        what: str,
    ) -> Future[Any]:
        """The earlier result of a computation, or its failure. Raises ReplayMismatch for other arguments."""
        from concurrent.futures import Future

        facts = known["facts"]
        recorded = facts.get("arguments_as_json", facts["arguments"])
        if (what and recorded != what) or known["name"] != function_name(function):
            raise ReplayMismatch(
                self._record.experiment,
                known["key"],
                f"{known['name']} of arguments {recorded[:12]}",
                f"{function_name(function)} of arguments {what[:12]}, {_show_arguments(args, named)}",
            )
        done: Future[Any] = Future()
        if "error" in facts:
            done.set_exception(_make_failure(known["name"], facts))
        else:
            done.set_result(self._read_value(facts))
        return done

    def _read_value(self, facts: Mapping[str, Any]) -> Any:
        if "result" in facts:
            return facts["result"]
        content = self._record.file(facts["result_file"])
        # The lab stores only files that this experiment has sent, and returns no other content for a digest.
        return msgspec.json.decode(content) if facts["result_form"] == "json" else pickle.loads(content)

    def close(self, *, drop: bool, wait: bool) -> None:
        if self._computing is not None:
            self._computing.close(drop=drop, wait=wait)
            self._computing = None

    def _log_computation(self, key: str, kind: str, computed: Computed, what: str) -> Any:
        """Log the computation: the event is in the log before the application has the result."""
        from labos.services.compute._work import encode

        measured = computed.measured
        form, content = encode(measured.value)
        facts: dict[str, Any] = {
            "code": computed.code,
            "arguments": computed.arguments,
            **_as_json(what, computed.arguments),
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
            facts["result_file"] = self._record.keep_file(content)
        kept = self._record.keep(key, kind, computed.function, facts)["facts"]
        if kept["result_sha256"] == facts["result_sha256"]:
            return measured.value
        return self._read_value(kept)  # the killed program had logged it in the meantime

    def _log_failure(self, key: str, kind: str, failed: ComputeFailed, what: str) -> None:
        facts = {
            "code": failed.code,
            "arguments": failed.arguments,
            **_as_json(what, failed.arguments),
            "where": failed.where,
            "attempts": failed.attempts,
            "error": f"{type(failed.error).__name__}: {failed.error}"[:LONGEST_ERROR],
        }
        self._record.keep(key, kind, failed.function, facts)


def _as_json(what: str, arguments: str) -> dict[str, str]:
    """The digest with which arguments are compared that were not sent as JSON, because their bytes differ
    between processes."""
    return {"arguments_as_json": what} if what not in ("", arguments) else {}


def _make_failure(name: str, facts: Mapping[str, Any]) -> ComputeFailed:
    """The error with which a computation ended in the earlier program."""
    from labos.services.compute import ComputeFailed

    kind, _, text = str(facts["error"]).partition(": ")
    error = type(kind, (Exception,), {})(text)
    code, arguments = str(facts["code"]), str(facts["arguments"])
    return ComputeFailed(name, facts["where"], facts["attempts"], error, code=code, arguments=arguments)


def _show_arguments(args: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    shown = [*map(repr, args), *(f"{name}={value!r}" for name, value in named.items())]
    return f"({', '.join(shown)})"[:LONGEST_SHOWN]
