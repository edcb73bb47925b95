"""The client for programs that work with asyncio: written by tests/docs/client_twin.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from labos.client._lab import LabClient
from labos.client._threads import Threads

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any


class AsyncCalls:
    """One method for each operation."""

    sync: LabClient
    threads: Threads

    async def actions(self, module: str) -> dict[str, Any]:
        """What a module can do."""
        return await self.threads.call(self.sync.actions, module)

    async def add_group(self, group: str, by: str) -> None:
        """Add a group."""
        await self.threads.call(self.sync.add_group, group, by)

    async def add_member(self, group: str, user: str, by: str) -> None:
        """Add a user to a group."""
        await self.threads.call(self.sync.add_member, group, user, by)

    async def add_user(
        self, user: str, by: str, *, kind: str = "person", role: str | None = None, scope: str = "*"
    ) -> None:
        """Let a person or a program use the lab."""
        await self.threads.call(self.sync.add_user, user, by, kind=kind, role=role, scope=scope)

    async def apply_policy(self, text: str, file: str, by: str) -> None:
        """Let the policy be as a file says."""
        await self.threads.call(self.sync.apply_policy, text, file, by)

    async def apply_shares(self, text: str, file: str, by: str) -> None:
        """Let weights and quotas be as a shares file says."""
        await self.threads.call(self.sync.apply_shares, text, file, by)

    async def approval_forecast(self, subject: str) -> dict[str, Any]:
        """What a submission that waits for an approval would bring."""
        return await self.threads.call(self.sync.approval_forecast, subject)

    async def approval_of(self, subject: str) -> dict[str, Any]:
        """What waits for an approval, and how it differs from what was approved before."""
        return await self.threads.call(self.sync.approval_of, subject)

    async def approve(
        self,
        subject: str,
        by: str,
        digest: str,
        *,
        comment: str = "",
        priority: int | None = None,
        deadline: str | None = None,
        runs: int | None = None,
        lab_time_s: float | None = None,
        consumables: Mapping[str, float] | None = None,
        alike: bool = False,
    ) -> str:
        """Let a submission go on, as it is or with changes."""
        return await self.threads.call(
            self.sync.approve,
            subject,
            by,
            digest,
            comment=comment,
            priority=priority,
            deadline=deadline,
            runs=runs,
            lab_time_s=lab_time_s,
            consumables=consumables,
            alike=alike,
        )

    async def approve_erasure(self, erasure: str, by: str) -> dict[str, Any]:
        """Agree, as the second person, that words are erased."""
        return await self.threads.call(self.sync.approve_erasure, erasure, by)

    async def archive_campaign(self, campaign: str, by: str, *, undo: bool = False) -> None:
        """Leave a campaign that has ended out of lists."""
        await self.threads.call(self.sync.archive_campaign, campaign, by, undo=undo)

    async def barcode(self, labware: str, barcode: str, by: str, *, replace: bool = False) -> None:
        """Say which barcode labware bears."""
        await self.threads.call(self.sync.barcode, labware, barcode, by, replace=replace)

    async def begin_sign_in(self, port: int, *, device: bool = False) -> dict[str, Any]:
        """Sign in with an identity provider: the address of its page."""
        return await self.threads.call(self.sync.begin_sign_in, port, device=device)

    async def book(
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
        """Book a module or a workcell."""
        return await self.threads.call(
            self.sync.book,
            target,
            begins_at,
            ends_at,
            by,
            whom=whom,
            maintenance=maintenance,
            why=why,
            zone=zone,
            rule=rule,
            last_at=last_at,
            force=force,
        )

    async def booking(self, booking: str) -> dict[str, Any]:
        """A booking."""
        return await self.threads.call(self.sync.booking, booking)

    async def bookings(self, target: str = "") -> list[dict[str, Any]]:
        """Which bookings there are."""
        return await self.threads.call(self.sync.bookings, target)

    async def calendar(self, since: int = 0, until: int = 0, target: str = "") -> dict[str, Any]:
        """When what is booked."""
        return await self.threads.call(self.sync.calendar, since, until, target)

    async def calendar_file(self, target: str = "") -> bytes:
        """The calendar for calendar programs."""
        return await self.threads.call(self.sync.calendar_file, target)

    async def calibrate(
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
        """Record a calibration of a module."""
        return await self.threads.call(
            self.sync.calibrate,
            module,
            by,
            what=what,
            certificate=certificate,
            report=report,
            until=until,
            why=why,
        )

    async def campaign(self, campaign: str) -> dict[str, Any]:
        """A campaign that has not been completed: how far it is, and its terms."""
        return await self.threads.call(self.sync.campaign, campaign)

    async def campaign_signatures(self, campaign: str) -> list[dict[str, Any]]:
        """Who has signed the record of a campaign."""
        return await self.threads.call(self.sync.campaign_signatures, campaign)

    async def campaigns(self) -> list[dict[str, Any]]:
        """Campaigns that have not been completed."""
        return await self.threads.call(self.sync.campaigns)

    async def cancel(self, run: str, by: str = "somebody", *, stay: bool = False, why: str = "") -> None:
        """Cancel a run."""
        await self.threads.call(self.sync.cancel, run, by, stay=stay, why=why)

    async def cancel_booking(self, booking: str, by: str, *, begins_at: int = 0, why: str = "") -> None:
        """Give a booking back, or one time of it."""
        await self.threads.call(self.sync.cancel_booking, booking, by, begins_at=begins_at, why=why)

    async def cancel_campaign(self, campaign: str, by: str, *, why: str = "", stay: bool = False) -> None:
        """Cancel a campaign."""
        await self.threads.call(self.sync.cancel_campaign, campaign, by, why=why, stay=stay)

    async def change_booking(
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
        """Change when or for whom a booking is."""
        return await self.threads.call(
            self.sync.change_booking,
            booking,
            by,
            begins_at=begins_at,
            ends_at=ends_at,
            whom=whom,
            maintenance=maintenance,
            why=why,
            zone=zone,
            rule=rule,
            last_at=last_at,
            force=force,
        )

    async def declare(
        self,
        stations: Mapping[str, Sequence[str]] | None,
        by: str,
        *,
        workcell: str = "",
        empty: bool = False,
    ) -> dict[str, list[str]]:
        """Declare what stands at stations."""
        return await self.threads.call(self.sync.declare, stations, by, workcell=workcell, empty=empty)

    async def disable_user(self, user: str, by: str) -> None:
        """Let a user do nothing any more."""
        await self.threads.call(self.sync.disable_user, user, by)

    async def emergency_stop(self, target: str, by: str = "somebody") -> dict[str, Any]:
        """Stop modules at once, in an emergency."""
        return await self.threads.call(self.sync.emergency_stop, target, by)

    async def enable_user(self, user: str, by: str) -> None:
        """Let a disabled user act again."""
        await self.threads.call(self.sync.enable_user, user, by)

    async def end_experiment(self, experiment: str, why: str = "ended", user: str = "") -> None:
        """End an experiment."""
        await self.threads.call(self.sync.end_experiment, experiment, why, user)

    async def enter(self, workcell: str, by: str, why: str = "", *, park: bool = True) -> list[str]:
        """Ask to reach into a workcell."""
        return await self.threads.call(self.sync.enter, workcell, by, why, park=park)

    async def erase_person(self, user: str) -> None:
        """Forget who a user is."""
        await self.threads.call(self.sync.erase_person, user)

    async def erase_words(
        self, because: str, by: str, *, records: Sequence[int] = (), user: str = ""
    ) -> dict[str, Any]:
        """Erase what people wrote into events."""
        return await self.threads.call(self.sync.erase_words, because, by, records=records, user=user)

    async def erasures(self) -> list[dict[str, Any]]:
        """What is to be erased, and waits for a second person."""
        return await self.threads.call(self.sync.erasures)

    async def experiment_signatures(self, experiment: str) -> list[dict[str, Any]]:
        """Who has signed the record of an experiment."""
        return await self.threads.call(self.sync.experiment_signatures, experiment)

    async def find(
        self,
        words: str = "",
        *,
        kind: Sequence[str] = (),
        user: Sequence[str] = (),
        workcell: Sequence[str] = (),
        workflow: Sequence[str] = (),
        experiment: Sequence[str] = (),
        run: Sequence[str] = (),
        status: Sequence[str] = (),
        keyword: Sequence[str] = (),
        since: int = 0,
        until: int = 0,
        limit: int = 20,
        offset: int = 0,
        facets: bool = False,
    ) -> dict[str, Any]:
        """What can be found by words."""
        return await self.threads.call(
            self.sync.find,
            words,
            kind=kind,
            user=user,
            workcell=workcell,
            workflow=workflow,
            experiment=experiment,
            run=run,
            status=status,
            keyword=keyword,
            since=since,
            until=until,
            limit=limit,
            offset=offset,
            facets=facets,
        )

    async def finish_sign_in(
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
        """Sign in with an identity provider: a token."""
        return await self.threads.call(
            self.sync.finish_sign_in,
            state,
            key,
            code=code,
            iss=iss,
            error=error,
            label=label,
            scope=scope,
            days=days,
        )

    async def forecast(self) -> dict[str, Any]:
        """When runs start and end, and when a person is needed."""
        return await self.threads.call(self.sync.forecast)

    async def give(self, labware: str, to: str, by: str, *, force: bool = False, note: str = "") -> None:
        """Hand labware over."""
        await self.threads.call(self.sync.give, labware, to, by, force=force, note=note)

    async def grant_role(self, subject: str, role: str, by: str, *, scope: str = "*") -> None:
        """Give a user or a group a role."""
        await self.threads.call(self.sync.grant_role, subject, role, by, scope=scope)

    async def groups(self) -> list[dict[str, Any]]:
        """Groups, their members and their roles."""
        return await self.threads.call(self.sync.groups)

    async def health(self) -> dict[str, Any]:
        """Whether the kernel works."""
        return await self.threads.call(self.sync.health)

    async def heartbeat(self, experiment: str, user: str = "") -> None:
        """Say that the application lives."""
        await self.threads.call(self.sync.heartbeat, experiment, user)

    async def identity(self) -> dict[str, Any]:
        """Who asks, and what they may do."""
        return await self.threads.call(self.sync.identity)

    async def inventory(self) -> dict[str, Any]:
        """What is left, and what runs out when."""
        return await self.threads.call(self.sync.inventory)

    async def keep_file(self, experiment: str, content: bytes, user: str = "") -> str:
        """Keep a file of an experiment."""
        return await self.threads.call(self.sync.keep_file, experiment, content, user)

    async def link_identity(self, user: str, issuer: str, subject: str) -> None:
        """Say whom an identity provider means by a user."""
        await self.threads.call(self.sync.link_identity, user, issuer, subject)

    async def load(self, station: str, labware: str, by: str, *, count: int = 1, lot: str = "") -> list[str]:
        """Say that labware was loaded."""
        return await self.threads.call(self.sync.load, station, labware, by, count=count, lot=lot)

    async def locations(self, module: str) -> dict[str, dict[str, Any]]:
        """Where a manipulator finds stations."""
        return await self.threads.call(self.sync.locations, module)

    async def make_token(
        self, label: str = "", *, scope: str = "submitter", days: float = 90.0, user: str = ""
    ) -> dict[str, Any]:
        """Make a token for a program."""
        return await self.threads.call(self.sync.make_token, label, scope=scope, days=days, user=user)

    async def note(
        self,
        experiment: str,
        kind: str,
        name: str,
        facts: Mapping[str, Any] | None = None,
        user: str = "",
        *,
        key: str = "",
    ) -> None:
        """Log something of the application's own."""
        await self.threads.call(self.sync.note, experiment, kind, name, facts, user, key=key)

    async def observe(self, station: str, what: str, by: str) -> dict[str, Any]:
        """Say what stands at a station."""
        return await self.threads.call(self.sync.observe, station, what, by)

    async def pause(self, run: str, by: str = "somebody", *, why: str = "") -> None:
        """Start no more steps of a run."""
        await self.threads.call(self.sync.pause, run, by, why=why)

    async def pause_campaign(self, campaign: str, by: str, *, why: str = "") -> None:
        """Submit no further row of a campaign until it is resumed."""
        await self.threads.call(self.sync.pause_campaign, campaign, by, why=why)

    async def people(self) -> list[dict[str, Any]]:
        """Who users are."""
        return await self.threads.call(self.sync.people)

    async def place(self, station: str, labware: str, by: str) -> str:
        """Say that labware was put on an empty station."""
        return await self.threads.call(self.sync.place, station, labware, by)

    async def policy(self) -> dict[str, Any]:
        """Which submissions wait for an approval, and how high a priority may be."""
        return await self.threads.call(self.sync.policy)

    async def put_back(self, module: str, by: str = "somebody") -> None:
        """Put a module back in service."""
        await self.threads.call(self.sync.put_back, module, by)

    async def refuse(self, subject: str, by: str, *, comment: str = "") -> str:
        """Do not let a submission go on."""
        return await self.threads.call(self.sync.refuse, subject, by, comment=comment)

    async def refuse_erasure(self, erasure: str, by: str) -> str:
        """Do not erase what waits for a second person."""
        return await self.threads.call(self.sync.refuse_erasure, erasure, by)

    async def remove_group(self, group: str, by: str) -> None:
        """Remove a group."""
        await self.threads.call(self.sync.remove_group, group, by)

    async def remove_member(self, group: str, user: str, by: str) -> None:
        """Take a user out of a group."""
        await self.threads.call(self.sync.remove_member, group, user, by)

    async def replenish(
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
        """Say that more of a resource was put in."""
        return await self.threads.call(
            self.sync.replenish,
            module,
            resource,
            by,
            amount=amount,
            unit=unit,
            lot=lot,
            expires=expires,
            instead=instead,
        )

    async def resolve(
        self, intervention: str, choice: str, by: str, note: str = "", result: Any = None
    ) -> None:
        """Answer a question."""
        await self.threads.call(self.sync.resolve, intervention, choice, by, note, result)

    async def resume(self, run: str, by: str = "somebody") -> None:
        """Go on with a run that is paused."""
        await self.threads.call(self.sync.resume, run, by)

    async def resume_campaign(self, campaign: str, by: str) -> None:
        """Go on with a campaign that is paused."""
        await self.threads.call(self.sync.resume_campaign, campaign, by)

    async def resume_experiment(self, experiment: str, name: str, user: str = "") -> None:
        """Go on with an experiment."""
        await self.threads.call(self.sync.resume_experiment, experiment, name, user)

    async def revoke_role(self, subject: str, by: str, *, scope: str = "*") -> None:
        """Take a role away."""
        await self.threads.call(self.sync.revoke_role, subject, by, scope=scope)

    async def revoke_token(self, token: str) -> None:
        """Revoke a token."""
        await self.threads.call(self.sync.revoke_token, token)

    async def round(self) -> dict[str, Any]:
        """What has to be said of the bench after the log lost its end."""
        return await self.threads.call(self.sync.round)

    async def runs(
        self, after: int = 0, *, limit: int = 100, ended: int = 0, before: int = 0
    ) -> dict[str, Any]:
        """Runs that are alive, and the last that have ended."""
        return await self.threads.call(self.sync.runs, after, limit=limit, ended=ended, before=before)

    async def say(
        self,
        by: str,
        stations: Mapping[str, Sequence[str]] | None = None,
        as_recorded: Sequence[str] = (),
        *,
        finish: bool = False,
    ) -> dict[str, Any]:
        """Say on the round what stands where."""
        return await self.threads.call(self.sync.say, by, stations, as_recorded, finish=finish)

    async def set_password(self, user: str, password: str, present: str = "") -> None:
        """Change a user's password."""
        await self.threads.call(self.sync.set_password, user, password, present)

    async def set_person(self, user: str, *, name: str | None = None, mail: str | None = None) -> None:
        """Say who a user is."""
        await self.threads.call(self.sync.set_person, user, name=name, mail=mail)

    async def shares(self) -> list[dict[str, Any]]:
        """Who is to have which part of the lab, and who has had which."""
        return await self.threads.call(self.sync.shares)

    async def sign_campaign(
        self, campaign: str, meaning: str, password: str, *, why: str = ""
    ) -> dict[str, Any]:
        """Sign the record of a campaign that has ended."""
        return await self.threads.call(self.sync.sign_campaign, campaign, meaning, password, why=why)

    async def sign_experiment(
        self, experiment: str, meaning: str, password: str, *, why: str = ""
    ) -> dict[str, Any]:
        """Sign the record of an experiment that has ended."""
        return await self.threads.call(self.sync.sign_experiment, experiment, meaning, password, why=why)

    async def sign_in(
        self, user: str, password: str, *, label: str = "signed in", scope: str = "admin", days: float = 30.0
    ) -> dict[str, Any]:
        """Sign in with a password."""
        return await self.threads.call(self.sync.sign_in, user, password, label=label, scope=scope, days=days)

    async def sign_out(self) -> None:
        """Sign out."""
        await self.threads.call(self.sync.sign_out)

    async def sign_run(self, run: str, meaning: str, password: str, *, why: str = "") -> dict[str, Any]:
        """Sign the record of a run that has ended."""
        return await self.threads.call(self.sync.sign_run, run, meaning, password, why=why)

    async def signatures(self, run: str) -> list[dict[str, Any]]:
        """Who has signed the record of a run."""
        return await self.threads.call(self.sync.signatures, run)

    async def state(self, *, waits: bool = True) -> dict[str, Any]:
        """Everything that is alive."""
        return await self.threads.call(self.sync.state, waits=waits)

    async def suggest_order(
        self, workcell: str, steps: Sequence[Mapping[str, Any]], until: int, position: int = 0, *, by: str
    ) -> int:
        """Suggest in which order the next steps of a workcell start."""
        return await self.threads.call(self.sync.suggest_order, workcell, steps, until, position, by=by)

    async def suggested_order(self, workcell: str) -> dict[str, Any]:
        """In which order a planner suggests that the next steps of a workcell start."""
        return await self.threads.call(self.sync.suggested_order, workcell)

    async def take_out(self, module: str, why: str, by: str, until_ns: int = 0) -> None:
        """Take a module out of service."""
        await self.threads.call(self.sync.take_out, module, why, by, until_ns)

    async def teach(
        self,
        module: str,
        station: str,
        pose: Sequence[float],
        by: str,
        why: str = "",
        *,
        labware_type: str = "",
    ) -> int:
        """Teach a manipulator a station."""
        return await self.threads.call(
            self.sync.teach, module, station, pose, by, why, labware_type=labware_type
        )

    async def tokens(self, user: str = "") -> list[dict[str, Any]]:
        """Tokens of programs."""
        return await self.threads.call(self.sync.tokens, user)

    async def trace(self, module: str, by: str = "somebody", *, on: bool = True) -> str:
        """Begin or end the transcript of a device's wires."""
        return await self.threads.call(self.sync.trace, module, by, on=on)

    async def unload(
        self, station: str, by: str, *, labware: str = "", count: int | None = None
    ) -> dict[str, Any]:
        """Say that labware was taken away."""
        return await self.threads.call(self.sync.unload, station, by, labware=labware, count=count)

    async def user(self, user: str) -> dict[str, Any]:
        """A user, with the roles of that user."""
        return await self.threads.call(self.sync.user, user)

    async def users(self) -> list[dict[str, Any]]:
        """Who may use the lab, and with which roles."""
        return await self.threads.call(self.sync.users)
