"""Submissions that wait for an approval, and their differences from the last approved one of the same
name."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import unified_diff
from typing import Any

import msgspec

from labos.core.approvals import Proposal
from labos.core.ids import CampaignId
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.errors import LabosError
from labos.ports import BlobReader, LogQuery
from labos.services.log import Log, decode_event

MOST_LINES = 200
"""At most so many lines of a difference between two texts are shown."""

MOST_VALUES = 200
"""At most so many different values are compared."""


class ChangedPart(msgspec.Struct, frozen=True):
    """A part that differs from the last approved submission of this name. ``lines`` show the difference if
    possible: lines that were removed (``-``) and added (``+``), or values together with their earlier
    ones."""

    part: str
    lines: tuple[str, ...] = ()


def describe_waiting(state: LabState, subject: str) -> str:
    """A sentence that a submission waits for an approval, why, and what to do; empty if it does not wait."""
    proposal = state.approvals.open.get(subject)
    if proposal is None:
        return ""
    what = {"amendment": f"The change of {subject}"}.get(proposal.kind, subject)
    why = ", and ".join(why.text for why in proposal.why)
    return f"{what} waits for approval, because {why}. An operator answers: labos approve {subject}"


def list_differences(log: Log, blobs: BlobReader, state: LabState, proposal: Proposal) -> list[ChangedPart]:
    """The differences of a proposal from the last approved one of its name. Reads the log and texts that are
    stored beside it."""
    if proposal.kind == "amendment":
        campaign = state.campaigns.open.get(CampaignId(proposal.subject))
        was = msgspec.to_builtins(campaign.terms) if campaign is not None else {}
        return [ChangedPart("terms", tuple(compare(was, msgspec.to_builtins(proposal.terms))))]
    past = state.approvals.find_last(proposal.kind, proposal.name)
    if past is None:
        return []
    return [ChangedPart(part, _compare_lines(log, blobs, proposal, past, part)) for part in proposal.changed]


def _compare_lines(
    log: Log, blobs: BlobReader, proposal: Proposal, past: Proposal, part: str
) -> tuple[str, ...]:
    was, now = past.parts.get(part, ""), proposal.parts.get(part, "")
    if part == "payload":
        old, new = _find_payload(log, past.subject), _find_payload(log, proposal.subject)
        return () if old is None or new is None else tuple(compare(old, new))
    if part == "terms":
        return tuple(compare(msgspec.to_builtins(past.terms), msgspec.to_builtins(proposal.terms)))
    if part == "workflow" or part.startswith("file:"):
        return tuple(_compare_texts(_read_text(blobs, was), _read_text(blobs, now)))
    return ()


def _find_payload(log: Log, run: str) -> dict[str, Any] | None:
    """The payload with which a run was submitted."""
    record = next(iter(log.select(LogQuery(streams=(run,), types=(RunSubmitted.TYPE,)))), None)
    event = decode_event(record) if record is not None else None
    return event.payload if isinstance(event, RunSubmitted) else None


def _read_text(blobs: BlobReader, digest: str) -> str | None:
    """A text that is stored beside the log; for the definition of a campaign, the text of its workflow."""
    try:
        text = blobs.get(digest).decode() if digest else ""
    except (LabosError, UnicodeDecodeError, OSError):
        return None
    try:
        whole = msgspec.json.decode(text)
    except msgspec.MsgspecError:
        return text
    return str(whole["text"]) if isinstance(whole, dict) and isinstance(whole.get("text"), str) else text


def _compare_texts(old: str | None, new: str | None) -> Iterator[str]:
    if old is None or new is None:
        return
    lines = unified_diff(old.splitlines(), new.splitlines(), "before", "now", lineterm="", n=1)
    for number, line in enumerate(lines):
        if number == MOST_LINES:
            yield "…"
            return
        yield line


def compare(old: dict[str, Any] | None, new: dict[str, Any] | None) -> Iterator[str]:
    """The values that differ, each with its earlier value."""
    before, now = _flatten_table(old or {}), _flatten_table(new or {})
    for number, key in enumerate(k for k in {**before, **now} if before.get(k, _NONE) != now.get(k, _NONE)):
        if number == MOST_VALUES:
            yield "…"
            return
        yield f"{key}: {_show_value(before, key)} -> {_show_value(now, key)}"


_NONE = object()


def _show_value(values: dict[str, Any], key: str) -> str:
    return msgspec.json.encode(values[key]).decode() if key in values else "not given"


def _flatten_table(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict) and value:
            found |= _flatten_table(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
