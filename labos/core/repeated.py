"""What is asked for again while it is so already: nothing changes, and the word about it is kept."""

from __future__ import annotations

from typing import Any

from labos.core.registry import Event, event


@event("request.repeated")
class RequestRepeated(Event, frozen=True):
    """Somebody repeated, with a reason, a request that was already carried out or under way. ``request`` is
    ``cancel``, ``pause``, ``access`` …; ``subject`` is the thing that it concerns. The event's actor is the
    user who asked."""

    subject: str
    request: str
    why: str

    def stream(self) -> str:
        return self.subject


HANDLERS: dict[Any, Any] = {}
"""No state depends on it."""


def record_repeat(subject: str, request: str, why: str) -> list[Event]:
    """The events of a request that changes nothing: none, unless a reason was given."""
    return [RequestRepeated(subject, request, why)] if why else []
