"""A request for a state that already holds: nothing changes, and its reason is recorded."""

from __future__ import annotations

from labos.core.registry import Event, event


@event("request.repeated")
class RequestRepeated(Event, frozen=True):
    """A user repeated, with a reason, a request that was already carried out or under way. ``request`` is
    ``cancel``, ``pause``, ``access`` …; ``subject`` is the thing that it concerns. The event's actor is the
    user who asked."""

    STREAM = "subject"
    subject: str
    request: str
    why: str


def record_repeat(subject: str, request: str, why: str) -> list[Event]:
    """The events of a request that changes nothing: none, unless the request has a reason."""
    return [RequestRepeated(subject, request, why)] if why else []
