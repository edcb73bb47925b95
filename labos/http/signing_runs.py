"""Signs the record of a run, of an experiment or of a campaign; the user has to give the password again."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from labos.core.decide import Command
from labos.core.decide.signatures import SignRecords, SignRun
from labos.core.ids import RunId
from labos.core.structs import make_from
from labos.errors import Forbidden, NotFound, NotSignedIn
from labos.http.bodies import RunSignature
from labos.http.signing import expect_users
from labos.services.shown import show_struct
from labos.services.signatures import Kind, Signature, Signed, find_kind, list_signatures, record_of

if TYPE_CHECKING:
    from labos.http.operation import Call


async def sign(call: Call, subject: str, kind: Kind, asked: RunSignature) -> Signature:
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
    for known in await asyncio.to_thread(list_signatures, store, subject):
        if (known.by, known.meaning) != (user, asked.meaning) or not known.holds:
            continue
        if (await asyncio.to_thread(show_struct, store, known)).why == asked.why:
            return known
    await call.kernel.execute(_command(subject, record, user, asked), call.user)
    found = await asyncio.to_thread(list_signatures, store, subject)
    return [each for each in found if each.by == user][-1]


async def list_signatures_under(call: Call, subject: str, kind: Kind) -> list[Signature]:
    """Raises NotFound."""
    await _expect_seen(call, subject, kind)
    store = call.service.parts.store
    await call.kernel.flush()
    if await asyncio.to_thread(find_kind, store, subject) != kind:
        raise NotFound(f"There is no {kind} {subject!r}.", remedy="Check its name.")
    return await asyncio.to_thread(list_signatures, store, subject)


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
