"""Questions: their types, and those that earlier versions asked without one."""

from __future__ import annotations

import json
from typing import Any, get_args

import pytest

from labos.core.canonical import encode_canonical
from labos.core.interventions import Interventions
from labos.core.registry import decode, encode
from labos.core.topics import AnyTopic, Approval, BookedPlace, LostLabware
from labos.errors import LogTooNew
from tests.support.topics import TOPICS

WITHOUT_TOPIC = [topic for topic in TOPICS if not isinstance(topic, Approval | BookedPlace)]
"""Of types that were asked when questions had none yet."""


def make_old_question(topic: AnyTopic) -> dict[str, Any]:
    """The payload of a question as it was written before questions had topics."""
    payload: dict[str, Any] = json.loads(encode(Interventions().ask(topic, "?")))
    del payload["topic"]
    return payload


def test_every_type_is_among_the_examples() -> None:
    assert {type(topic) for topic in TOPICS} == set(get_args(AnyTopic))


@pytest.mark.parametrize("topic", WITHOUT_TOPIC, ids=lambda topic: type(topic).__name__)
def test_a_question_of_before_is_about_the_same(topic: AnyTopic) -> None:
    event: Any = decode("intervention.requested", 1, encode_canonical(make_old_question(topic)))
    assert event.topic == topic


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: type(topic).__name__)
def test_a_question_is_kept_with_its_topic(topic: AnyTopic) -> None:
    event: Any = Interventions().ask(topic, "?", 5)
    assert decode("intervention.requested", 2, encode(event)) == event
    assert (event.kind, event.subject, event.run, event.module) == (
        topic.KIND,
        topic.subject,
        topic.run,
        topic.module,
    )
    names = [choice.name for choice in event.choices]
    assert names
    assert isinstance(topic, LostLabware) or len(set(names)) == len(names)


def test_a_topic_of_a_later_version_is_refused() -> None:
    payload = {**make_old_question(TOPICS[0]), "topic": {"topic": "weather"}}
    with pytest.raises(LogTooNew):
        decode("intervention.requested", 2, encode_canonical(payload))
