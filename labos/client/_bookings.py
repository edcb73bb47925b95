"""The calls of a client about bookings and the calendar."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from labos.client._calls import Calls


class BookingCalls(Calls):
    """Who has a module or a workcell to themselves. Times in UTC ns; ``by`` is who asks, in a lab that has no
    users yet."""

    def bookings(self, target: str = "") -> list[dict[str, Any]]:
        """Those that are not over; only those of a module or a workcell, if one is named. Raises NotFound."""
        return list(self._get("/bookings", target=target)["bookings"])

    def booking(self, booking: str) -> dict[str, Any]:
        """As one of ``bookings``. Raises NotFound."""
        return self._get(f"/bookings/{booking}")

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
        """Book a module or a workcell for a group or a user (``whom``; whoever asks), or for maintenance.
        With a ``rule`` of iCalendar (``FREQ=WEEKLY``) it comes again by the clock of the ``zone``. Raises
        Refused where somebody has booked already, unless an admin asks with ``force``."""
        body = {
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
        }
        return self._post("/bookings", body, request=self._ids.new())

    def change_booking(self, booking: str, by: str, **changes: Any) -> dict[str, Any]:
        """``changes`` are named as the options of ``book``; what is left out stays as it is."""
        return self._post(f"/bookings/{booking}/change", {**changes, "by": by}, repeat=True)

    def cancel_booking(self, booking: str, by: str, *, begins_at: int = 0, why: str = "") -> None:
        """All of it, or the one time of it that begins then."""
        body = {"by": by, "begins_at": begins_at, "why": why}
        self._post(f"/bookings/{booking}/cancel", body, request=self._ids.new())

    def calendar(self, since: int = 0, until: int = 0, target: str = "") -> dict[str, Any]:
        """Each time that is booked from ``since`` (0: now) to ``until`` (0: a week later)."""
        return self._get("/calendar", since=since, until=until, target=target)

    def calendar_file(self, target: str = "") -> bytes:
        """All bookings as iCalendar."""
        return self._fetch("/calendar.ics", target=target)

    @abstractmethod
    def _fetch(self, path: str, **params: Any) -> bytes:
        """The answer as it is. Raises LabosError as the lab did, LabUnreachable."""
