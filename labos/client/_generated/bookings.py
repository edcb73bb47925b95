"""The operations of labos/http/routes/bookings.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedBookings(Calls):
    """One method for each operation."""

    def bookings(self, target: str = "") -> list[dict[str, Any]]:
        """List the bookings. The bookings that have not ended, in the order of their next times. ``target``:
        only those of this workcell, or of this module (including those of its workcell). Raises NotFound."""
        return self._get("/bookings", target=target)["bookings"]

    def book(
        self,
        target: str,
        begins_at: int,
        ends_at: int,
        by: str,
        *,
        whom: str = "",
        maintenance: bool = False,
        why: str = "",
        zone: str = "UTC",
        rule: str = "",
        last_at: int = 0,
        force: bool = False,
    ) -> dict[str, Any]:
        """Book a module or a workcell. Runs of other users start nothing that would still be there at that
        time. If another user or group has a booking at that time, the request is refused, unless an admin
        forces it. A booking for maintenance cannot be overridden. ``target``: a module or a workcell.
        ``begins_at``: when it begins (UTC nanoseconds). ``ends_at``: when it ends (UTC nanoseconds).
        ``whom``: the group or user for whom it is booked; ``group:NAME`` or ``user:ID`` if both have this
        name; left out: the user who asks. ``maintenance``: a booking for maintenance, during which no run
        uses it. ``why``: what for. ``zone``: the time zone in which the booking is shown and repeated, such
        as ``Europe/Zurich``. ``rule``: how it repeats, as in iCalendar: ``FREQ=WEEKLY;BYDAY=MO,TH``; empty:
        once. ``last_at``: the latest beginning of a repeated booking (UTC nanoseconds); 0: without end.
        ``force``: override bookings of others; only for admins. Returns ``id``, ``target``, ``begins_at``,
        ``ends_at``, ``user``, ``group``, ``maintenance``, ``why``, ``zone``, ``rule``, ``last_at``, ``by``,
        ``now``, ``next_begins_at``, ``next_ends_at``, ``skipped_at``, ``over``. Raises NotFound, Refused."""
        return self._post("/bookings", locals(), once=True)

    def booking(self, booking: str) -> dict[str, Any]:
        """A booking. Returns ``id``, ``target``, ``begins_at``, ``ends_at``, ``user``, ``group``,
        ``maintenance``, ``why``, ``zone``, ``rule``, ``last_at``, ``by``, ``now``, ``next_begins_at``,
        ``next_ends_at``, ``skipped_at``, ``over``."""
        return self._get(f"/bookings/{in_path(booking)}")

    def change_booking(
        self,
        booking: str,
        by: str,
        *,
        begins_at: int | None = None,
        ends_at: int | None = None,
        whom: str | None = None,
        maintenance: bool | None = None,
        why: str | None = None,
        zone: str | None = None,
        rule: str | None = None,
        last_at: int | None = None,
        force: bool = False,
    ) -> dict[str, Any]:
        """Change the time or the owner of a booking. Fields that are left out do not change. If only the
        beginning is given, the end moves by the same time. ``begins_at``: when it begins (UTC nanoseconds);
        if no end is given, the end moves by the same time. ``ends_at``: when it ends (UTC nanoseconds).
        ``whom``: the group or user for whom it is booked; ``group:NAME`` or ``user:ID`` if both have this
        name. ``maintenance``: a booking for maintenance, during which no run uses it. ``why``: what for.
        ``zone``: the time zone in which the booking is shown and repeated, such as ``Europe/Zurich``.
        ``rule``: how it repeats, as in iCalendar: ``FREQ=WEEKLY;BYDAY=MO,TH``; empty: once. ``last_at``: the
        latest beginning of a repeated booking (UTC nanoseconds); 0: without end. ``force``: override bookings
        of others; only for admins. Returns ``id``, ``target``, ``begins_at``, ``ends_at``, ``user``,
        ``group``, ``maintenance``, ``why``, ``zone``, ``rule``, ``last_at``, ``by``, ``now``,
        ``next_begins_at``, ``next_ends_at``, ``skipped_at``, ``over``. Raises Refused."""
        return self._post("/bookings/{booking}/change", locals(), repeat=True)

    def cancel_booking(self, booking: str, by: str, *, begins_at: int = 0, why: str = "") -> None:
        """Cancel a booking, or one time of it. Everybody may then use that time, also if it has begun.
        ``begins_at``: for a repeated booking: cancel only the time that begins then (UTC nanoseconds).
        ``why``: the reason. Raises Refused."""
        self._post("/bookings/{booking}/cancel", locals(), once=True)

    def calendar(self, since: int = 0, until: int = 0, target: str = "") -> dict[str, Any]:
        """List the booked times. Each time of each booking, also of repeated ones. ``since``: the beginning
        of the period (UTC nanoseconds); 0: now. ``until``: the end of the period (UTC nanoseconds); 0: a
        week. ``target``: only those of this workcell, or of this module (including those of its workcell).
        Returns ``since``, ``until``, ``times``. Raises NotFound."""
        return self._get("/calendar", since=since, until=until, target=target)

    def calendar_file(self, target: str = "") -> bytes:
        """The calendar for calendar programs. All bookings as iCalendar (RFC 5545). A calendar program
        subscribes to it with a token of scope ``viewer`` in the address. ``target``: only those of this
        workcell, or of this module (including those of its workcell). Raises NotFound."""
        return self._fetch("/calendar.ics", target=target)
