"""Traces of runs, made of the events of logs that were kept."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.core.fold import evolve
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.runtime.ledger import Entry
from labos.services.log import decode_events
from labos.telemetry.spans import Span, SpanRecorder, make_trace_id
from tests.golden.test_golden import NAMES, log

COMMIT_NS = 3_000_000


def entries(name: str) -> list[Entry]:
    return [
        Entry(record, event) for record, (event, _) in zip(log(name), decode_events(log(name)), strict=True)
    ]


def spans_of(name: str, *, restart_at: int = 0) -> list[Span]:
    """What a kernel tells that hears each event by itself, on disk 3 ms after it was recorded. It may have
    started anew at a position, with what the log says up to there."""
    state, found, now = LabState(), [], [0]
    recorder = SpanRecorder(lambda: state, lambda: now[0], found.append)
    for entry in entries(name):
        head = entry.record.head
        evolve(state, entry.event, head.position, head.recorded_at)
        if head.position == restart_at:
            recorder = SpanRecorder(lambda: state, lambda: now[0], found.append)
            recorder.begin_with(state)
        elif head.position > restart_at:
            now[0] = head.recorded_at + COMMIT_NS
            recorder.on_committed([entry])
    return found


@pytest.mark.parametrize("name", NAMES)
def test_each_span_lies_in_the_one_it_belongs_to(name: str) -> None:
    found = spans_of(name)
    by_id = {span.id: span for span in found}
    assert len(by_id) == len(found)
    for span in found:
        assert span.start <= span.end
        if span.parent and span.parent in by_id:
            above = by_id[span.parent]
            assert above.trace == span.trace
            assert above.start <= span.start
            # An action is on disk a moment after its step has ended by the log.
            assert span.end <= above.end + COMMIT_NS, (span, above)


@pytest.mark.parametrize("name", NAMES)
def test_each_run_that_ended_and_each_sending_has_one(name: str) -> None:
    found, log_lines = spans_of(name), entries(name)
    kinds = Counter(entry.event.TYPE for entry in log_lines)
    ended = kinds["run.completed"] + kinds["run.failed"] + kinds["run.cancelled"]
    assert sum(span.name.startswith("run ") for span in found) == ended
    sent = sum(span.name == "commit request" for span in found)
    over = sum(kinds[f"action.{how}"] for how in ("succeeded", "failed", "rejected", "unknown"))
    assert sent == over > 0
    runs = [entry.event.run for entry in log_lines if isinstance(entry.event, RunSubmitted)]
    lab = log_lines[0].record.head.lab
    assert {span.trace for span in found if span.name.startswith("run ")} <= {
        make_trace_id(lab, r) for r in runs
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_kernel_that_starts_in_between_goes_on_with_the_same_traces(name: str) -> None:
    whole = {span.id: span for span in spans_of(name)}
    middle = len(entries(name)) // 2
    later = spans_of(name, restart_at=middle)
    assert later
    for span in later:
        known = whole[span.id]
        assert (known.trace, known.parent, known.end) == (span.trace, span.parent, span.end)
        if not span.name.startswith("step "):
            assert (known.name, known.start) == (span.name, span.start)
    at = entries(name)[middle - 1].record.head.recorded_at
    missed = {s.id for s in whole.values() if s.start > at} - {s.id for s in later}
    assert missed == set()


def test_a_step_is_called_as_in_its_workflow_and_says_what_went_wrong() -> None:
    steps = [span for name in NAMES for span in spans_of(name) if span.name.startswith("step ")]
    assert any(not span.name.removeprefix("step ").isdigit() for span in steps)
    errors = {span.error for name in NAMES for span in spans_of(name)}
    assert len(errors) > 1
