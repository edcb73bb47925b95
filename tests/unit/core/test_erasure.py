"""Words of a command are referred to before it is decided; erasing them is decided like anything else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from labos.core.decide import Command, Rejection, carry_out, decide
from labos.core.decide._base import DECIDERS, Report
from labos.core.decide.bookings import ChangeBooking, MakeBooking, NewTerms
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.control import CancelExperiment, PauseStarts
from labos.core.decide.erasure import PER_EVENT, EraseWords, RefuseErasure
from labos.core.decide.experiments import EndExperiment
from labos.core.decide.handover import HandOver
from labos.core.decide.limits import BAD_TEXT
from labos.core.decide.nodes import TakeOut
from labos.core.decide.submissions import ApplyPolicy
from labos.core.decide.wording import list_words, refer_to_words
from labos.core.erasure import ErasureAsked, ErasureRefused, WordsErased, list_references_in_words
from labos.core.experiments import ExperimentCancelled
from labos.core.ids import ExperimentId, ModuleName, RunId
from labos.core.lab import StartsPaused
from labos.core.policy import Policy
from labos.core.registry import Event, encode
from labos.core.state import LabState, encode_picture, from_picture, hash_state, rewrite_picture
from labos.core.words import (
    ERASED,
    Kept,
    find_fields_of_words,
    keep,
    list_references,
    make_reference,
    put_into_json,
    put_into_text,
)
from tests.support.bench import CELL, Driver, plan, small, step

SALT = b"0123456789abcdef"
HOUR = 3_600_000_000_000


def make_reference_writer(kept: dict[str, str]) -> Callable[[str], str]:
    def put(text: str) -> str:
        reference = make_reference(SALT, text)
        kept[reference] = text
        return reference

    return put


def obey(lab: Driver, command: Command, actor: str = "bo") -> tuple[list[Event], dict[str, str]]:
    """What a command leads to whose words stand beside the log, and these words."""
    kept: dict[str, str] = {}
    written = carry_out(lab.state, command, lab.write, actor, make_reference_writer(kept))
    assert not isinstance(written, Rejection), written
    return written, kept


# -- references ------------------------------------------------------------------------------------


def test_a_reference_depends_on_salt_and_text() -> None:
    one = make_reference(SALT, "no")
    assert one != make_reference(b"f" * 16, "no")
    assert one != make_reference(SALT, "yes")
    assert list_references(f'{{"why":"{one}, and {one}"}}'.encode()) == [one]
    assert list_references(b'{"why":"words: nothing"}') == []


def test_texts_are_put_in_as_json_writes_them() -> None:
    text = 'says "no"\nand \\ so: ' + make_reference(SALT, "inner")
    one, two = make_reference(SALT, text), make_reference(SALT, "two")
    data = f'{{"why":"bo said: {one}","note":"{two}"}}'.encode()
    told = msgspec.json.decode(put_into_json(data, {one: text}))
    assert told == {
        "why": f"bo said: {text}",
        "note": ERASED,
    }
    assert put_into_text(f"bo: {one}; {two}", {two: "2"}) == f"bo: {ERASED}; 2"


def test_a_text_is_genuine_with_its_salt_only() -> None:
    kept = keep("no", SALT)
    assert kept.is_genuine
    assert not msgspec.structs.replace(kept, text="yes").is_genuine
    assert not msgspec.structs.replace(kept, salt=b"f" * 16).is_genuine
    assert Kept(kept.reference, b"", "").is_genuine


# -- commands --------------------------------------------------------------------------------------


def test_every_word_of_a_command_is_declared() -> None:
    """Commands of people: what devices and nodes report, and what LabOS asks of itself, are not theirs."""
    told_by_labos = {"RefuseRow", "DoubtNode", "OutrankNode", "BindAnew"}
    for kind in DECIDERS:
        if issubclass(kind, Report) or kind.__name__ in told_by_labos:
            continue
        texts = {name for name in kind.__struct_fields__ if name in ("why", "note", "comment", "reason")}
        assert texts == set(find_fields_of_words(kind)), kind


def test_events_state_and_longer_sentences_refer_to_the_words() -> None:
    lab = small()
    experiment = lab.experiment()
    events, kept = obey(lab, CancelExperiment(ExperimentId(experiment), "bo", why="it is late"))
    (cancelled,) = [event for event in events if isinstance(event, ExperimentCancelled)]
    ((reference, text),) = kept.items()
    assert text == "it is late"
    assert cancelled.why == f"cancelled by bo: {reference}"
    assert list_references_in_words(cancelled.TYPE, encode(cancelled)) == [reference]
    assert b"it is late" not in encode_picture(lab.state)
    lab.check_log()


def test_what_is_nested_and_what_stands_in_parts_is_referred_to() -> None:
    terms = NewTerms(begins=1, ends=2, user="bo", why="course")
    kept: dict[str, str] = {}
    made = refer_to_words(MakeBooking("dev", terms, "bo", 0), make_reference_writer(kept))
    assert kept == {made.terms.why: "course"}
    assert list(list_words(MakeBooking("dev", terms, "bo", 0))) == [("course", "why")]


def test_a_changed_booking_keeps_its_reason() -> None:
    lab = small()
    terms = NewTerms(begins=lab.now + HOUR, ends=lab.now + 2 * HOUR, user="bo", why="course")
    (made, *_), kept = obey(lab, MakeBooking(f"{CELL}/dev", terms, "bo", lab.now))
    later = msgspec.structs.replace(terms, ends=lab.now + 3 * HOUR, why=None)
    (changed, *_), none = obey(lab, ChangeBooking(made.booking, later, "bo", lab.now))  # type: ignore[attr-defined]
    assert changed.why in kept  # type: ignore[attr-defined]
    assert none == {}


@pytest.mark.parametrize(
    "command",
    [
        EndExperiment(ExperimentId("E1")),
        CancelRun(RunId("R1")),
        HandOver("P1", "bo", "ada", force=True, note="  "),  # type: ignore[arg-type]
    ],
)
def test_what_nobody_wrote_stays(command: Command) -> None:
    kept: dict[str, str] = {}
    assert refer_to_words(command, make_reference_writer(kept)) == command
    assert kept == {}


@pytest.mark.parametrize("why", ["x" * 1001, "two\nlines"])
def test_words_are_measured_before_they_are_referred_to(why: str) -> None:
    lab = small()
    for command in (
        PauseStarts("*", "bo", why),
        TakeOut(ModuleName(f"{CELL}/dev"), why, 0),
        MakeBooking(f"{CELL}/dev", NewTerms(begins=1, ends=2, why=why), "bo", 0),
    ):
        found = decide(lab.state, command, "bo", make_reference_writer({}))
        assert isinstance(found, Rejection)
        assert found.code == BAD_TEXT


def test_somebody_who_types_a_reference_has_written_a_text() -> None:
    lab = small()
    typed = make_reference(SALT, "the secret of somebody else")
    events, kept = obey(lab, PauseStarts("*", "bo", typed))
    assert kept[events[0].why] == typed  # type: ignore[attr-defined]


def test_the_state_is_the_same_whatever_becomes_of_the_text() -> None:
    one, other = small(), small()
    for lab in (one, other):
        obey(lab, PauseStarts("*", "bo", "lunch"))
    assert hash_state(one.state) == hash_state(other.state)
    shown = rewrite_picture(encode_picture(one.state), lambda text: put_into_text(text, {}))
    assert from_picture(shown).lab.paused["*"].why == ERASED


# -- erasing ---------------------------------------------------------------------------------------


def make_found(number: int = 1) -> tuple[tuple[int, str], ...]:
    return tuple((at, f"{at:064x}") for at in range(1, number + 1))


def test_an_erasure_says_who_why_and_which() -> None:
    lab = small()
    (gone,) = lab.do(EraseWords("personal", "ada", make_found(), (1,)), "ada")
    assert isinstance(gone, WordsErased)
    assert (gone.by, gone.because, gone.records, gone.approved_by) == ("ada", "personal", (1,), "")
    assert gone.references() == [f"words:{1:064x}"]
    lab.check_log()


def test_many_texts_take_several_events() -> None:
    lab = small()
    gone = lab.do(EraseWords("request", "ada", make_found(2 * PER_EVENT + 1), user="bo"), "ada")
    assert [len(event.digests) for event in gone if isinstance(event, WordsErased)] == [
        PER_EVENT,
        PER_EVENT,
        1,
    ]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"because": "as I like"}, "no_reason"),
        ({"found": ()}, "no_words"),
        ({"records": ()}, "no_words"),
        ({"user": "bo"}, "no_words"),
        ({"records": tuple(range(1, 1002))}, "no_words"),
        ({"found": ((1, "words"),)}, "no_words"),
        ({"erasure": "X7"}, "no_erasure"),
    ],
)
def test_what_is_no_erasure_is_refused(changes: dict[str, Any], code: str) -> None:
    command = msgspec.structs.replace(EraseWords("personal", "ada", make_found(), (1,)), **changes)
    refused = decide(LabState(), command, "ada")
    assert isinstance(refused, Rejection)
    assert refused.code == code


def make_waiting_lab() -> Driver:
    lab = small()
    lab.do(ApplyPolicy("d", Policy(erasure=True)), "ada")
    (asked,) = lab.do(EraseWords("personal", "ada", make_found(), (1,)), "ada")
    assert isinstance(asked, ErasureAsked)
    assert asked.erasure == "X1"
    return lab


def test_by_policy_a_second_person_agrees() -> None:
    lab = make_waiting_lab()
    again = EraseWords("personal", "ada", make_found(), (1,), erasure="X1")
    refused = decide(lab.state, again, "ada")
    assert isinstance(refused, Rejection)
    assert refused.code == "same_person"
    other = EraseWords("secret", "olga", make_found(), (1,), erasure="X1")
    changed = decide(lab.state, other, "olga")
    assert isinstance(changed, Rejection)
    assert changed.code == "changed"
    (gone,) = lab.do(msgspec.structs.replace(again, by="olga"), "olga")
    assert isinstance(gone, WordsErased)
    assert (gone.by, gone.approved_by, gone.erasure) == ("ada", "olga", "X1")
    assert lab.state.erasures.open == {}
    lab.check_log()


def test_what_waits_can_be_refused() -> None:
    lab = make_waiting_lab()
    assert lab.do(RefuseErasure("X1", "olga"), "olga") == [ErasureRefused("X1", "olga")]
    assert lab.state.erasures.open == {}
    (asked,) = lab.do(EraseWords("personal", "ada", make_found(), (1,)), "ada")
    assert asked.erasure == "X2"  # type: ignore[attr-defined]
    lab.check_log()


def test_runs_go_on_through_all_of_it() -> None:
    lab = make_waiting_lab()
    lab.submit(plan(step("cam")))
    assert isinstance(lab.do(PauseStarts("*", "ada"))[0], StartsPaused)
