"""Each text in an event is either words of a person, or data that is listed here."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

import msgspec

from labos.core import fold
from labos.core.registry import TYPES
from labos.core.words import Words, are_words, find_fields_of_words

# Ids, names, codes, digests and values: they are looked up, compared or decided by.
DATA = frozenset(
    {
        "about",
        "accepts",
        "access",
        "action",
        "actions",
        "aliases",
        "amount",
        "args",
        "argument",
        "approved_by",
        "barcode",
        "because",
        "before",
        "blob",
        "booking",
        "by",
        "by_run",
        "certificate",
        "changed",
        "choice",
        "choices",
        "claim",
        "closing",
        "code",
        "config",
        "consequence",
        "consumables",
        "contents",
        "dangerous",
        "dangers",
        "definition",
        "digest",
        "digests",
        "driver",
        "due",
        "erasure",
        "error",
        "evidence",
        "expired",
        "expires",
        "facts",
        "file",
        "files",
        "grips",
        "group",
        "hazard",
        "instance",
        "journal",
        "key",
        "kind",
        "knows",
        "labware_type",
        "levels",
        "liquid",
        "lost_by",
        "lot",
        "lots",
        "meaning",
        "members",
        "method",
        "model",
        "module",
        "modules",
        "name",
        "of",
        "of_step",
        "other_type",
        "over",
        "parking",
        "parts",
        "payload",
        "pins",
        "plan",
        "planned_by",
        "reach",
        "reach_of",
        "reads",
        "refuses",
        "request",
        "resource",
        "rest",
        "rule",
        "run",
        "sample",
        "scope",
        "setpoint",
        "shape",
        "sheet",
        "source",
        "source_grip",
        "status",
        "step",
        "subject",
        "table",
        "tags",
        "target",
        "target_grip",
        "tree",
        "trusted",
        "type",
        "units",
        "until",
        "user",
        "users",
        "variable",
        "variables",
        "version",
        "well",
        "wells",
        "what",
        "workcell",
        "workflow",
        "zone",
    }
)

# What LabOS, a node or a device says, and words of a plan's author.
SAID_BY_LABOS = frozenset(
    {
        "ActionRejected.why",
        "ActionUnknown.why",
        "CampaignCompleted.why",
        "CampaignRowRefused.why",
        "CampaignStopped.why",
        "Condition.text",
        "InterventionRequested.text",
        "LabwareRemoved.why",
        "LabwareUncertain.why",
        "NodeLeft.why",
        "RequestRepeated.why",
        "RunBound.why",
        "RunCancelling.why",
        "RunFailed.why",
        "StepRecovering.why",
        "StepRetried.why",
        "StepSkipped.why",
        "StepUnexpected.why",
        "StopReported.silent",
        "Why.text",
    }
)


def texts(hint: Any, where: str, seen: set[type]) -> Iterator[str]:
    """Each plain text that a value of this type may hold, as the structure's name and the field's."""
    if are_words(hint):
        return
    if hint is str:
        yield where
    elif isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        if hint not in seen:
            seen.add(hint)
            hints = typing.get_type_hints(hint, include_extras=True)
            for name in hint.__struct_fields__:
                yield from texts(hints[name], f"{hint.__name__}.{name}", seen)
    else:
        for inner in typing.get_args(hint):
            yield from texts(inner, where, seen)


def all_texts() -> set[str]:
    assert fold  # it registers the events
    seen: set[type] = set()
    return {text for kind in TYPES.values() for text in texts(kind, kind.__name__, seen)}


def test_every_text_is_words_or_known_not_to_be() -> None:
    unknown = {
        text for text in all_texts() if text not in SAID_BY_LABOS and text.partition(".")[2] not in DATA
    }
    assert unknown == set(), "declare it as Words, or list it here"


def test_nothing_is_listed_that_no_event_has() -> None:
    found = all_texts()
    assert found >= SAID_BY_LABOS
    assert {text.partition(".")[2] for text in found - SAID_BY_LABOS} == DATA


def test_what_people_write_is_words() -> None:
    assert find_fields_of_words(TYPES["intervention.resolved"]) == ("note",)
    assert find_fields_of_words(TYPES["run.cancelled"]) == ("why",)
    assert find_fields_of_words(TYPES["booking.made"]) == ("why",)
    assert find_fields_of_words(TYPES["lab.created"]) == ()


def test_a_field_of_words_takes_any_text_and_nothing_else() -> None:
    assert msgspec.json.decode(b'"\xc3\xa9 \\n"', type=Words) == "é \n"
    assert msgspec.json.schema(Words) == {"type": "string"}
