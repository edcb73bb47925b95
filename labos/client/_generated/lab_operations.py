"""The operations of labos/http/routes (lab, accounts, log, modules, bookings, bench, people, words); written
by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls


class LabOperations(Calls):
    """One method for each operation."""

    def health(self) -> dict[str, Any]:
        """Show whether the kernel works. Probes can use ``/health``, which answers ``{"status": …}`` and
        needs no user. Returns ``status``, ``lab``, ``name``, ``epoch``, ``position``, ``suspended``,
        ``simulated``, ``pace``, ``broken_drivers``, ``log_check``."""
        return self._get("/health", locals())

    def state(self, *, waits: bool = True) -> dict[str, Any]:
        """Show the present state of the lab. Requests at the same time share one answer, which is newer than
        each of them. ``waits``: whether to give the reasons why runs wait, which takes time to compute; true
        if left out. Returns ``lab``, ``position``, ``now``, ``modules``, ``stations``, ``labware``, ``runs``,
        ``queued``, ``interventions``, ``experiments``, ``resources``."""
        return self._get("/state", locals())

    def inventory(self) -> dict[str, Any]:
        """Show the resources that are left, and when they run out. Levels and lots of all resources, the
        content of stacks, the room in waste stations, and in ``runs_out`` the first run that would have too
        little. Times are in UTC nanoseconds. Returns ``resources``, ``stacks``, ``runs_looked_at``,
        ``wastes``."""
        return self._get("/inventory", locals())

    def emergency_stop(self, target: str, by: str = "somebody") -> dict[str, Any]:
        """Stop modules at once, in an emergency. The stop does not wait for the log; it is logged afterwards.
        It is not a safety function. ``stopped`` are the modules that confirmed the stop, with the time (UTC
        nanoseconds); ``silent`` are the others. A stopped module is in the state ERROR until a run of its
        action ``reset``, which ``labos reset`` submits. ``target``: a module, a workcell, or ``*`` for
        everything. Returns ``stopped``, ``silent``. Raises NotFound."""
        return self._post("/estop", locals(), repeat=True, timeout_s=5.0)

    def sign_in(
        self, user: str, password: str, *, label: str = "signed in", scope: str = "admin", days: float = 30.0
    ) -> dict[str, Any]:
        """Sign in with a password. A browser gets a session of 12 hours, as a cookie that scripts cannot
        read. A program asks for a ``token``. After six wrong attempts within a minute, further attempts are
        refused. ``user``: the user's id. ``password``: the password. ``label``: what the token is for.
        ``scope``: the highest role that the token allows. ``days``: the number of days for which the token is
        valid. Returns ``user``, ``until``, ``token``. Raises Refused."""
        return self._post("/login", locals() | {"token": True})

    def begin_sign_in(self, port: int, *, device: bool = False) -> dict[str, Any]:
        """Begin to sign in with an identity provider: get the address of its page. For a command line. The
        user opens the address in a browser. On the same computer, the browser returns to a local port. For a
        ``device`` without a browser, the user enters the code in a browser elsewhere. The sign-in expires
        after ten minutes. ``port``: the local port to which the browser returns. ``device``: there is no
        browser on this computer: get a code for a browser elsewhere. Returns ``address``, ``state``, ``key``,
        ``code``, ``wait_s``. Raises NotFound, Refused."""
        return self._post("/login/provider", locals())

    def finish_sign_in(
        self,
        state: str,
        key: str,
        *,
        code: str = "",
        iss: str = "",
        error: str = "",
        label: str = "signed in",
        scope: str = "admin",
        days: float = 30.0,
    ) -> dict[str, Any]:
        """Finish signing in with an identity provider: get a token. The request holds the parameters with
        which the browser returned from the provider. For a ``device`` there are none: repeat the request
        every ``wait_s`` seconds until there is a token. ``state``: the value from the answer that began the
        sign-in. ``key``: the value from the answer that began the sign-in. ``code``: the parameter with which
        the browser returned. ``iss``: the parameter with which the browser returned. ``error``: the parameter
        with which the browser returned. ``label``: what the token is for. ``scope``: the highest role that
        the token allows. ``days``: the number of days for which the token is valid; the lab may allow fewer.
        Returns ``user``, ``until``, ``token``, ``wait_s``. Raises NotFound, Refused."""
        return self._post("/login/provider/finish", locals())

    def sign_out(self) -> None:
        """Sign out. The session of the cookie ends, or the token of the request is revoked. Their open
        streams end too."""
        self._post("/logout", locals())

    def identity(self) -> dict[str, Any]:
        """Show the user who asks, and the user's rights. Returns ``user``, ``how``, ``scope``, ``kind``,
        ``group``, ``roles``, ``name``, ``mail``, ``until``."""
        return self._get("/whoami", locals())

    def tokens(self, user: str = "") -> list[dict[str, Any]]:
        """Tokens of programs. The answer has no secrets: the lab does not store them. ``user``: the owner;
        only admins may name another user."""
        return self._get("/tokens", locals())["tokens"]

    def make_token(
        self, label: str = "", *, scope: str = "submitter", days: float = 90.0, user: str = ""
    ) -> dict[str, Any]:
        """Make a token for a program. The secret is shown only in this answer. A token that was made with
        another token is never valid longer and never allows more than that one. ``label``: its purpose.
        ``scope``: the highest role that it allows. ``days``: the number of days for which it is valid.
        ``user``: the owner; only admins may name another user. Returns ``token``, ``secret``. Raises
        NotFound, Refused."""
        return self._post("/tokens", locals())

    def revoke_token(self, token: str) -> None:
        """Revoke a token. The token is invalid from now on; streams that were opened with it end."""
        self._post("/tokens/{token}/revoke", locals(), repeat=True)

    def people(self) -> list[dict[str, Any]]:
        """List the names of users."""
        return self._get("/people", locals())["people"]

    def set_password(self, user: str, password: str, present: str = "") -> None:
        """Change a user's password. All sessions of the user end; tokens stay. ``password``: the new
        password, at least 10 characters. ``present``: the present password; required from users who change
        their own."""
        self._post("/users/{user}/password", locals())

    def set_person(self, user: str, *, name: str | None = None, mail: str | None = None) -> None:
        """Change the name and address of a user. They are stored beside the log, which contains only the ids
        of users. ``name``: the user's name. ``mail``: an address."""
        self._post("/users/{user}/person", locals(), repeat=True)

    def erase_person(self, user: str) -> None:
        """Erase a user's name, address and means of signing in. The name, the address, the password and all
        tokens and sessions are deleted. Events remain and contain the id. A further event records the
        erasure."""
        self._post("/users/{user}/erase", locals(), repeat=True)

    def link_identity(self, user: str, issuer: str, subject: str) -> None:
        """Link a user to an account at an identity provider. The account with this ``subject`` at the
        identity provider belongs to this user. ``issuer``: the identity provider, as
        ``https://login.example.org``. ``subject``: the provider's id of the user (the claim ``sub``)."""
        self._post("/users/{user}/identity", locals(), repeat=True)

    def take_out(self, module: str, why: str, by: str, until_ns: int = 0) -> None:
        """Take a module out of service. Actions under way continue to their end; nothing more starts there.
        ``why``: the reason. ``until_ns``: the time at which it is in service again (UTC nanoseconds); 0: when
        a person puts it back. Raises Refused."""
        self._post(
            "/modules/{module}/out-of-service", {"module": module, "why": why, "by": by, "until": until_ns}
        )

    def put_back(self, module: str, by: str = "somebody") -> None:
        """Put a module back in service. Raises Refused."""
        self._post("/modules/{module}/in-service", locals(), repeat=True)

    def trace(self, module: str, by: str = "somebody", *, on: bool = True) -> str:
        """Start or stop the transcript of a device's links. The module's node records every byte on the links
        to its device, or stops doing so ([links](../links.md)). ``on``: true or left out: start a transcript
        in a new file; false: stop it. Returns the file. Raises Refused."""
        return self._post("/modules/{module}/trace", locals(), repeat=True)["file"]

    def replenish(
        self,
        module: str,
        resource: str,
        by: str,
        *,
        amount: float = 0.0,
        unit: str = "",
        lot: str = "",
        expires: str = "",
        instead: bool = False,
    ) -> float:
        """Report that a resource was refilled. An amount larger than the free room is refused. ``resource``:
        which resource of the module. ``amount``: in the unit of the resource; if left out, as much as there
        is room for. ``unit``: the unit of the amount, such as ``mL``; the unit of the resource if left out.
        ``lot``: the lot of the new pack. ``expires``: the expiry date, such as ``2027-05-31``. ``instead``:
        the rest of the old packs was taken out; ``false`` if left out. Returns the amount. Raises Refused."""
        return self._post("/modules/{module}/replenish", locals())["amount"]

    def locations(self, module: str) -> dict[str, dict[str, Any]]:
        """Show the poses of a manipulator by station. Version 0 is the pose of the workcell file. Poses for
        particular labware types are under ``types``."""
        return self._get("/modules/{module}/locations", locals())["locations"]

    def teach(
        self,
        module: str,
        station: str,
        pose: Sequence[float],
        by: str,
        why: str = "",
        *,
        labware_type: str = "",
    ) -> int:
        """Teach a manipulator the pose for a station. The node restarts with the new pose. ``station``: the
        station. ``pose``: the numbers of the pose, as many as in the present pose. ``why``: a comment for the
        log. ``labware_type``: the pose is only for labware of this type; the station needs a pose for all
        types first. Returns the version. Raises Refused."""
        return self._post("/modules/{module}/locations", locals(), repeat=True)["version"]

    def calibrate(
        self,
        module: str,
        by: str,
        *,
        what: str = "",
        certificate: str = "",
        report: bytes = b"",
        until: str = "",
        why: str = "",
    ) -> dict[str, Any]:
        """Record a calibration of a module. A later calibration of the same ``what`` replaces it. No run
        waits for a calibration, and none stops because a calibration has expired. ``/files/{sha256}`` returns
        the report. ``what``: the calibrated part or quantity, such as ``volume``; empty for the whole module.
        ``certificate``: the certificate's number. ``report``: the report, in base64; kept with the lab's
        files. ``until``: the last day on which it is valid, such as ``2027-01-01`` (UTC). ``why``: a comment
        for the log. Returns ``module``, ``what``, ``certificate``, ``file``, ``until``. Raises Refused."""
        return self._post("/modules/{module}/calibrations", locals(), once=True)

    def enter(self, workcell: str, by: str, why: str = "", *, park: bool = True) -> list[str]:
        """Request access to a workcell. Nothing more starts there. ``lab.access`` in the state shows when
        access is ``granted``, and which modules may still be moving because the outcome of their action is
        unknown (``perhaps_moving``). ``why``: what for. ``park``: false: arms stay where they are. Returns
        the parking. Raises Refused."""
        return self._post("/workcells/{workcell}/access", locals(), repeat=True)["parking"]

    def bookings(self, target: str = "") -> list[dict[str, Any]]:
        """List the bookings. The bookings that have not ended, in the order of their next times. ``target``:
        only those of this workcell, or of this module (including those of its workcell). Raises NotFound."""
        return self._get("/bookings", locals())["bookings"]

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
        return self._get("/bookings/{booking}", locals())

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
        return self._get("/calendar", locals())

    def calendar_file(self, target: str = "") -> bytes:
        """The calendar for calendar programs. All bookings as iCalendar (RFC 5545). A calendar program
        subscribes to it with a token of scope ``viewer`` in the address. ``target``: only those of this
        workcell, or of this module (including those of its workcell). Raises NotFound."""
        return self._fetch("/calendar.ics", locals())

    def resolve(self, intervention: str, choice: str, by: str, note: str = "", result: Any = None) -> None:
        """Answer a question. ``choice``: the name of one of its answers. ``note``: a comment. ``result``: the
        measured result of the completed step; required if later steps read it. Raises Refused."""
        self._post("/interventions/{intervention}", locals())

    def place(self, station: str, labware: str, by: str) -> str:
        """Report that labware was put on an empty station. ``station``: the station. ``labware``: its type.
        Returns the labware. Raises NotFound, Refused."""
        return self._post("/stations/place", locals())["labware"]

    def load(self, station: str, labware: str, by: str, *, count: int = 1, lot: str = "") -> list[str]:
        """Report that labware was loaded. The labware is on top of a stack, or in free slots. It is refused
        if the station does not accept it or has no room. ``station``: the station. ``labware``: its type.
        ``count``: the number of pieces; 1 if left out. ``lot``: their lot, which each piece keeps as its
        variable ``lot``. Returns the labware. Raises NotFound, Refused."""
        return self._post("/stations/load", locals())["labware"]

    def unload(self, station: str, by: str, *, labware: str = "", count: int | None = None) -> dict[str, Any]:
        """Report that labware was taken away. The labware has left the bench. It is refused for labware of a
        run or an experiment that has not ended. ``station``: the station. ``labware``: one piece, by its id
        or barcode. ``count``: or this number of pieces from the top; everything if neither is given. Returns
        ``labware``, ``nameless``. Raises NotFound, Refused."""
        return self._post("/stations/unload", locals())

    def observe(self, station: str, what: str, by: str) -> dict[str, Any]:
        """Report what stands at a station. The report narrows down uncertain places. If it contradicts the
        log, LabOS asks a question. It is refused while labware is being moved to or from the station.
        ``station``: the station. ``what``: ``empty``, a number, labware by its id or barcode, or a labware
        type; left out: something. Returns ``station``, ``found``, ``gone``, ``uncertain``, ``answered``,
        ``asked``. Raises NotFound, Refused."""
        return self._post("/stations/observe", locals())

    def declare(
        self,
        stations: Mapping[str, Sequence[str]] | None,
        by: str,
        *,
        workcell: str = "",
        empty: bool = False,
    ) -> dict[str, list[str]]:
        """Declare what stands at stations. The labware is listed from bottom to top. Either all stations are
        declared, or none. ``stations``: types of labware by station. ``workcell``: the workcell for
        ``empty``, if the lab has several. ``empty``: all stations that were not reported are empty. Returns
        the declared. Raises NotFound, Refused."""
        stations = stations or {}
        return self._post("/stations/declare", locals())["declared"]

    def round(self) -> dict[str, Any]:
        """Show what has to be reported of the bench after the log lost its end. The evidence that the log has
        lost its end, and the stations that have to be reported before anything starts. If the log is
        complete, the answer is empty. Returns ``intervention``, ``ended``, ``known``, ``evidence``,
        ``discovered``, ``not_known``, ``stations``."""
        return self._get("/round", locals())

    def say(
        self,
        by: str,
        stations: Mapping[str, Sequence[str]] | None = None,
        as_recorded: Sequence[str] = (),
        *,
        finish: bool = False,
    ) -> dict[str, Any]:
        """Report what stands at stations after the log lost its end. Each station is accepted or refused by
        itself. Labware is named by its id, or by its type if the log does not have it, with its lid
        (``P7+P8``, ``plate96+lid96``). For a waste station only the number matters. When no station is left,
        the intervention is answered with ``checked``. ``stations``: the labware at each station, from bottom
        to top: ids, or types if the log has no id. ``as_recorded``: stations that are as recorded.
        ``finish``: ``true``: answer the intervention if no station is left. Returns ``said``, ``refused``,
        ``left``, ``answered``, ``why_not``."""
        stations = stations or {}
        return self._post("/round", locals(), repeat=True)

    def barcode(self, labware: str, barcode: str, by: str, *, replace: bool = False) -> None:
        """Record the barcode of labware. It is refused if other labware on the bench has this barcode.
        ``barcode``: the text of the barcode. ``replace``: replace another barcode, because the label was
        changed. Raises Refused."""
        self._post("/labware/{labware}/barcode", locals(), repeat=True)

    def give(self, labware: str, to: str, by: str, *, force: bool = False, note: str = "") -> None:
        """Give labware to another owner. It is refused while a run uses the labware, while it is being moved
        or processed, and if it does not belong to ``by``. ``to``: ``user:NAME``, ``experiment:E3`` or
        ``shared``. ``force``: for operators: the labware belongs to somebody else. ``note``: a reason or
        comment; required with ``force``. Raises Refused."""
        self._post("/labware/{labware}/owner", locals(), repeat=True)

    def users(self) -> list[dict[str, Any]]:
        """List the users and their roles."""
        return self._get("/users", locals())["users"]

    def add_user(
        self, user: str, by: str, *, kind: str = "person", role: str | None = None, scope: str = "*"
    ) -> None:
        """Add a user: a person or a program. As soon as there is one user, only users may do anything. The
        first user becomes admin of the whole lab. The owner of the lab's folder adds the first user, with the
        content of ``home.key`` as the token. ``user``: the id, not the person's name: events contain it
        permanently. ``kind``: ``person``, or ``service`` for a program or an agent. ``role``: the first role;
        the first user of a lab is admin in any case. ``scope``: a workcell, or ``*`` for the whole lab.
        Raises Refused."""
        self._post("/users", locals())

    def user(self, user: str) -> dict[str, Any]:
        """Show a user and the user's roles. Returns ``id``, ``kind``, ``disabled``, ``since``, ``group``,
        ``roles``."""
        return self._get("/users/{user}", locals())

    def disable_user(self, user: str, by: str) -> None:
        """Disable a user. The user may no longer do anything. The user's runs continue; the user's campaigns
        are paused. Raises Refused."""
        self._post("/users/{user}/disable", locals(), repeat=True)

    def enable_user(self, user: str, by: str) -> None:
        """Enable a disabled user. Raises Refused."""
        self._post("/users/{user}/enable", locals(), repeat=True)

    def groups(self) -> list[dict[str, Any]]:
        """Groups, their members and their roles."""
        return self._get("/groups", locals())["groups"]

    def add_group(self, group: str, by: str) -> None:
        """Add a group. The group has weight 1; a shares file may set another weight. ``group``: its name.
        Raises Refused."""
        self._post("/groups", locals())

    def remove_group(self, group: str, by: str) -> None:
        """Remove a group. Its members are then in no group, and its roles are removed. The answer lists the
        remaining groups. Raises Refused."""
        self._post("/groups/{group}/remove", locals())

    def add_member(self, group: str, user: str, by: str) -> None:
        """Add a user to a group. A user can be in only one group. ``user``: a user's id. Raises Refused."""
        self._post("/groups/{group}/members", locals(), repeat=True)

    def remove_member(self, group: str, user: str, by: str) -> None:
        """Take a user out of a group. ``user``: a user's id. Raises Refused."""
        self._post("/groups/{group}/members/remove", locals(), repeat=True)

    def grant_role(self, subject: str, role: str, by: str, *, scope: str = "*") -> None:
        """Give a user or a group a role. It replaces the role that the user or group has there. ``subject``:
        ``user:ID`` or ``group:NAME``. ``role``: ``viewer``, ``submitter``, ``operator`` or ``admin``.
        ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/roles/grant", locals(), repeat=True)

    def revoke_role(self, subject: str, by: str, *, scope: str = "*") -> None:
        """Take a role away. A user without a role may only look. ``subject``: ``user:ID`` or ``group:NAME``.
        ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/roles/revoke", locals(), repeat=True)

    def erasures(self) -> list[dict[str, Any]]:
        """List the erasures that wait for a second person."""
        return self._get("/words/erasures", locals())["erasures"]

    def erase_words(
        self, because: str, by: str, *, records: Sequence[int] = (), user: str = ""
    ) -> dict[str, Any]:
        """Erase what people wrote into events. The texts and the salts of their digests are deleted. The
        events stay, and the log still verifies. Each text is then shown as ``(erased)``. An event records the
        erasure, the user and the reason. If the policy has ``erasure: true``, nothing is deleted before a
        second admin has agreed. ``because``: a code: ``request`` (the author, or the person whom the text
        concerns, asked for it), ``personal`` (it holds personal data that do not belong there), ``secret``
        (it holds a password or something confidential), ``mistake`` (it was written in the wrong place),
        ``retention`` (its retention period has ended), ``order`` (a court or an authority ordered it).
        ``records``: positions of the events whose words are erased. ``user``: erase the words of all events
        of this user. Returns ``erasure``, ``erased``, ``records``, ``position``, ``left``. Raises NotFound,
        Refused."""
        return self._post("/words/erasures", locals())

    def approve_erasure(self, erasure: str, by: str) -> dict[str, Any]:
        """Agree to an erasure, as the second person. The user who asked for the erasure cannot agree to it.
        The present words at these events are erased. Returns ``erasure``, ``erased``, ``records``,
        ``position``, ``left``. Raises Refused."""
        return self._post("/words/erasures/{erasure}/approve", locals())

    def refuse_erasure(self, erasure: str, by: str) -> str:
        """Refuse an erasure that waits for a second person. Nothing is erased. The user who asked can
        withdraw the request in this way. Raises Refused."""
        return self._post("/words/erasures/{erasure}/refuse", locals(), repeat=True)["erasure"]
