"""Electronic signatures for runs, experiments and campaigns."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from labos.core.decide import Command
from labos.core.decide.signatures import SignRecords, SignRun
from labos.core.ids import RunId
from labos.core.structs import make_from
from labos.errors import Forbidden, NotFound, NotSignedIn
from labos.http.bodies import RunSignature
from labos.http.operation import Call, Method, Operation, read
from labos.http.queries import OfCampaign, OfExperiment, OfRun
from labos.http.signing import expect_users
from labos.services.shown import show_struct
from labos.services.signatures import Kind, Signature, Signed, find_kind, record_of
from labos.services.signatures import list_signatures as read_signatures


class Signatures(msgspec.Struct, frozen=True):
    signatures: list[Signature]


_ASKED = {"meaning": "reviewed", "password": "four words of yours", "why": "checked"}
_SIGNATURE = {
    "subject": "R1",
    "kind": "run",
    "run": "R1",
    "by": "ada",
    "meaning": "reviewed",
    "why": "checked",
    "method": "password",
    "at": 1767225600000000000,
    "time": "2026-01-01T00:00:00.000000000Z",
    "position": 214,
    "runs": 0,
    "records": 37,
    "digest": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "holds": True,
}
_EXPERIMENT = {**_SIGNATURE, "subject": "E1", "kind": "experiment", "run": "", "runs": 3, "records": 97}
_CAMPAIGN = {**_EXPERIMENT, "subject": "C1", "kind": "campaign"}


def _sign(kind: Kind, example: dict[str, Any]) -> Operation:
    """The operation that signs such a record."""
    return Operation(
        route=f"POST {_make_path(kind)}",
        client=Method(f"sign_{kind}", repeat=True),
        summary=f"Sign {_name_record(kind)} that has ended",
        tag=f"{kind}s",
        needs="viewer",
        secret=True,
        problems=("refused", "not_found", "too_many_tries"),
        example=_ASKED,
        example_answer=example,
    )


def _list(kind: Kind, signatures: str, example: dict[str, Any]) -> Operation:
    """The operation that lists the signatures for such a record; ``signatures`` is the client's method."""
    return read(
        route=f"GET {_make_path(kind)}",
        client=Method(signatures, take="signatures"),
        summary=f"List the signatures for {_name_record(kind)}",
        tag=f"{kind}s",
        problems=("not_found",),
        example_answer={"signatures": [example]},
    )


def _make_path(kind: Kind) -> str:
    return f"/{kind}s/{{{kind}}}/signatures"


def _name_record(kind: Kind) -> str:
    return f"the record of {'an' if kind == 'experiment' else 'a'} {kind}"


@_sign("run", _SIGNATURE)
async def sign_run(call: Call, path: OfRun, body: RunSignature) -> Signature:
    """The signature is an event and covers all records of the run. The user has to give the password again,
    however they signed in."""
    return await _sign_record(call, path.run, "run", body)


@_list("run", "signatures", _SIGNATURE)
async def list_signatures(call: Call, path: OfRun) -> Signatures:
    """They are in the order of the log. `holds`: the record is still the one that was signed."""
    return await _list_under(call, path.run, "run")


@_sign("experiment", _EXPERIMENT)
async def sign_experiment(call: Call, path: OfExperiment, body: RunSignature) -> Signature:
    """It works as for a run. The signature covers all records of the experiment and of all its runs."""
    return await _sign_record(call, path.experiment, "experiment", body)


@_list("experiment", "experiment_signatures", _EXPERIMENT)
async def list_experiment_signatures(call: Call, path: OfExperiment) -> Signatures:
    """They are in the order of the log. `holds`: the records are still those that were signed."""
    return await _list_under(call, path.experiment, "experiment")


@_sign("campaign", _CAMPAIGN)
async def sign_campaign(call: Call, path: OfCampaign, body: RunSignature) -> Signature:
    """It works as for a run. The signature covers all records of the campaign and of all its runs."""
    return await _sign_record(call, path.campaign, "campaign", body)


@_list("campaign", "campaign_signatures", _CAMPAIGN)
async def list_campaign_signatures(call: Call, path: OfCampaign) -> Signatures:
    """They are in the order of the log. `holds`: the records are still those that were signed."""
    return await _list_under(call, path.campaign, "campaign")


async def _sign_record(call: Call, subject: str, kind: Kind, asked: RunSignature) -> Signature:
    """The signature of the requesting user; an earlier one with the same meaning and comment is returned
    again. Raises Forbidden, NotFound, Refused, TooManyTries."""
    expect_users(call.kernel.state)
    user, store = call.who.user, call.service.parts.store
    if not call.who.is_known:
        raise NotSignedIn("Only a user can sign.", remedy="Sign in: labos login")
    await _expect_seen(call, subject, kind)
    if not call.is_sent_on:
        await _expect_password(call, user, asked.password)
        asked.password = ""  # it must not be sent over the bus, from an API process to the kernel
    await call.kernel.flush()
    record = await asyncio.to_thread(record_of, store, subject, kind)
    for known in await asyncio.to_thread(read_signatures, store, subject):
        if (known.by, known.meaning) != (user, asked.meaning) or not known.holds:
            continue
        if (await asyncio.to_thread(show_struct, store, known)).why == asked.why:
            return known
    await call.kernel.execute(_command(subject, record, user, asked), call.user)
    found = await asyncio.to_thread(read_signatures, store, subject)
    return [each for each in found if each.by == user][-1]


async def _list_under(call: Call, subject: str, kind: Kind) -> Signatures:
    """Raises NotFound."""
    await _expect_seen(call, subject, kind)
    store = call.service.parts.store
    await call.kernel.flush()
    if await asyncio.to_thread(find_kind, store, subject) != kind:
        raise NotFound(f"There is no {kind} {subject!r}.", remedy="Check its name.")
    return Signatures(await asyncio.to_thread(read_signatures, store, subject))


async def _expect_seen(call: Call, subject: str, kind: Kind) -> None:
    """Raises NotFound."""
    of = subject
    if kind == "run" and call.hidden:
        of = (await call.service.read_story(subject)).campaign
    if of in call.hidden:
        raise NotFound(f"There is no {kind} {subject!r}.", remedy="Check its name.")


def _command(subject: str, signed: Signed, by: str, asked: RunSignature) -> Command:
    about = {"by": by, "meaning": asked.meaning, "method": "password", "why": asked.why}
    if signed.kind == "run":
        return make_from(SignRun, signed, run=RunId(subject), **about)
    return make_from(SignRecords, signed, subject=subject, **about)


async def _expect_password(call: Call, user: str, password: str) -> None:
    """Raises Forbidden, TooManyTries."""
    try:
        await call.api.gate.accounts.expect_password(user, password, call.address)
    except NotSignedIn:
        raise Forbidden(
            f"This is not the password of {user}. Nothing was signed.",
            remedy="Try again. Users of an identity provider need a password of this lab for signing: labos "
            f"user password {user}",
        ) from None
