"""The operations of labos/http/routes/bookings.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedBookings(Calls):
    """One method for each operation."""

    def bookings(self, target: str = "") -> list[dict[str, Any]]:
        """Which bookings there are. Those that are not over, in the order of their next times. ``target``:
        only those of this module (its workcell's among them) or of this workcell. Raises NotFound."""
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
        """Book a module or a workcell. Runs of others do not start what would still be there then. Where
        somebody has booked already it is refused, unless an admin forces it; over maintenance it is refused
        in any case. ``target``: a module or a workcell. ``begins_at``: when it begins (UTC nanoseconds).
        ``ends_at``: when it ends (UTC nanoseconds). ``whom``: for whom: a group or a user; ``group:NAME`` or
        ``user:ID`` where both are called so; left out: the user who asks. ``maintenance``: for maintenance:
        nobody's runs. ``why``: what for. ``zone``: the time zone by whose clock it is shown and repeated, as
        ``Europe/Zurich``. ``rule``: how often it comes again, as in iCalendar: ``FREQ=WEEKLY;BYDAY=MO,TH``;
        empty: once. ``last_at``: the latest begin of one that is repeated (UTC nanoseconds); 0: without end.
        ``force``: also where others have booked; it needs an admin. Returns ``id``, ``target``,
        ``begins_at``, ``ends_at``, ``user``, ``group``, ``maintenance``, ``why``, ``zone``, ``rule``,
        ``last_at``, ``by``, ``now``, ``next_begins_at``, ``next_ends_at``, ``skipped_at``, ``over``. Raises
        NotFound, Refused."""
        return self._post(
            "/bookings",
            {
                "target": target,
                "begins_at": begins_at,
                "ends_at": ends_at,
                "by": by,
                "whom": whom,
                "maintenance": maintenance,
                "why": why,
                "zone": zone,
                "rule": rule,
                "last_at": last_at,
                "force": force,
            },
            request=self._ids.new(),
        )

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
        """Change when or for whom a booking is. What is left out stays. A new begin alone moves the end
        along. ``begins_at``: when it begins (UTC nanoseconds); without an end, that moves along. ``ends_at``:
        when it ends (UTC nanoseconds). ``whom``: for whom: a group or a user; ``group:NAME`` or ``user:ID``
        where both are called so. ``maintenance``: for maintenance: nobody's runs. ``why``: what for.
        ``zone``: the time zone by whose clock it is shown and repeated, as ``Europe/Zurich``. ``rule``: how
        often it comes again, as in iCalendar: ``FREQ=WEEKLY;BYDAY=MO,TH``; empty: once. ``last_at``: the
        latest begin of one that is repeated (UTC nanoseconds); 0: without end. ``force``: also where others
        have booked; it needs an admin. Returns ``id``, ``target``, ``begins_at``, ``ends_at``, ``user``,
        ``group``, ``maintenance``, ``why``, ``zone``, ``rule``, ``last_at``, ``by``, ``now``,
        ``next_begins_at``, ``next_ends_at``, ``skipped_at``, ``over``. Raises Refused."""
        return self._post(
            f"/bookings/{in_path(booking)}/change",
            {
                "by": by,
                "begins_at": begins_at,
                "ends_at": ends_at,
                "whom": whom,
                "maintenance": maintenance,
                "why": why,
                "zone": zone,
                "rule": rule,
                "last_at": last_at,
                "force": force,
            },
            repeat=True,
        )

    def cancel_booking(self, booking: str, by: str, *, begins_at: int = 0, why: str = "") -> None:
        """Give a booking back, or one time of it. The time is everybody's again, also while it lasts.
        ``begins_at``: only the time that begins then (UTC nanoseconds), of a booking that is repeated.
        ``why``: the reason. Raises Refused."""
        self._post(
            f"/bookings/{in_path(booking)}/cancel",
            {"by": by, "begins_at": begins_at, "why": why},
            request=self._ids.new(),
        )

    def calendar(self, since: int = 0, until: int = 0, target: str = "") -> dict[str, Any]:
        """When what is booked. Each time of each booking, repeated ones too. ``since``: from then on (UTC
        nanoseconds); 0: from now on. ``until``: up to then (UTC nanoseconds); 0: a week. ``target``: only
        those of this module (its workcell's among them) or of this workcell. Returns ``since``, ``until``,
        ``times``. Raises NotFound."""
        return self._get("/calendar", since=since, until=until, target=target)

    def calendar_file(self, target: str = "") -> bytes:
        """The calendar for calendar programs. All bookings as iCalendar (RFC 5545). Calendar programs
        subscribe to it with a token of scope ``viewer`` in the address. ``target``: only those of this module
        (its workcell's among them) or of this workcell. Raises NotFound."""
        return self._fetch("/calendar.ics", target=target)
